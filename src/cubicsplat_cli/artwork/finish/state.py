"""A drawing against its picture: its layers, what they are fitted to, and how far they are off it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import summed
from cubicsplat_cli.artwork.finish.parameters import NO_PINS, Constraints, Parameters, Pins, Still, parametrised
from cubicsplat_cli.artwork.geometry.outlines import areas_beside
from cubicsplat_cli.artwork.input.restore import BLUR_REACH
from cubicsplat_cli.artwork.regions.fills import APART
from cubicsplat_cli.artwork.regions.sampling import FEW_SAMPLES
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.stack import DrawnStack, Goal, StackPieces
from cubicsplat_cli.scene.paint import Rgba

# Residuals beyond count linearly: they are details that no shape draws. Times the error of shares, for edges in steps.
HUBER, ERRORS = 0.15, 3.0
# px within which there is an edge whose side matters; the least residual of a pixel on the wrong side.
NEAR, FAINT_EDGE = 5, 0.05
# Weight of the squared share of the background that shows: 1/255 counts as much as what a pixel is off by chance.
LEAK_WEIGHT = 100.0
WHITE = np.sqrt(np.array([1.0, 1.0, 1.0, 2.0]))  # weight of the channels, so that opacity counts over white as well
ROUNDING = 4.0 / 12.0 / 255.0**2  # misfit of a pixel whose four channels were rounded to 8 bits
# Misfit of a pixel of shading in bands, whose three colours lie evenly within APART levels.
BANDED = 3.0 * (APART / 255.0) ** 2 / 12.0
UNSEEN = 1e-7  # misfit by chance below which a shape hardly shows
Over = tuple[DrawnStack, np.ndarray]  # the layers of another state, and where among them those of one lie


@dataclass(eq=False)
class Layer:
    """A shape while it is optimised. fill: (4,) premultiplied, in the goal's coordinates; signs: (outlines,) 1, or -1
    where a ring runs the wrong way round."""

    shape: Shape
    fill: np.ndarray
    outlines: list[Parameters]
    signs: list[float]

    def drawn(self) -> Shape:
        """Return the shape with its outlines as they stand."""
        return replace(self.shape, outlines=tuple(outline.outline() for outline in self.outlines))


class State:
    """A drawing against its picture. layers: back to front; goal: what they are fitted to; previous: a state of the
    same goal, of which unchanged parts are not drawn again; over: layers that stay as they are, see `DrawnStack`;
    changed: the outlines, by number, that alone differ from the previous state's, in as many pieces; None for any.

    outlines: of all layers; places: the layer of each, and its number there; pieces: (outlines + 1,) where those of
    each begin; owners: (pieces,) the outline of each piece; drawn: the pieces, and stack: they, as drawn.
    """

    def __init__(
        self,
        layers: list[Layer],
        goal: Goal,
        previous: State | None = None,
        over: Over | None = None,
        changed: Mapping[int, Parameters] | None = None,
    ) -> None:
        self.layers, self.goal, self.over = layers, goal, over
        if previous is None or changed is None:
            self._gather()
        else:
            self._follow(previous, changed)
        self.stack: DrawnStack = DrawnStack(self.drawn, goal, previous.stack if previous else None, over)

    def _gather(self) -> None:
        """Number the outlines of the layers and their pieces."""
        self.outlines = [o for layer in self.layers for o in layer.outlines]
        self.places = [(n, place) for n, layer in enumerate(self.layers) for place in range(len(layer.outlines))]
        cubics, lines = [o.cubics for o in self.outlines], [o.lines for o in self.outlines]
        sizes, signs = [*map(len, lines)], [sign for layer in self.layers for sign in layer.signs]
        self.pieces = np.cumsum([0, *sizes])
        self.owners = np.repeat(np.arange(len(sizes)), sizes)
        ends = self.pieces[np.cumsum([len(layer.outlines) for layer in self.layers])].astype(np.int32)
        fills = np.concatenate([layer.fill for layer in self.layers]).reshape(-1, 4)
        self.drawn = StackPieces(ends, np.concatenate(cubics), np.concatenate(lines), np.repeat(signs, sizes), fills)

    def _follow(self, previous: State, changed: Mapping[int, Parameters]) -> None:
        """Take over the numbers of another state: most steps move few of many outlines."""
        self.outlines, self.places = list(previous.outlines), previous.places
        self.pieces, self.owners = previous.pieces, previous.owners
        cubics, lines = previous.drawn.cubics.copy(), previous.drawn.lines.copy()
        for k, outline in changed.items():
            own = slice(self.pieces[k], self.pieces[k + 1])
            self.outlines[k], cubics[own], lines[own] = outline, outline.cubics, outline.lines
        self.drawn = replace(previous.drawn, cubics=cubics, lines=lines)

    def taken_back(self, before: State, worse: np.ndarray) -> State:
        """The state with the outlines of an earlier one where these are worse (outlines,) bool."""
        return self.with_outlines({k: before.outlines[k] for k in np.flatnonzero(worse).tolist()})

    def with_layers(self, layers: list[Layer]) -> State:
        """The state of other layers, of which only what differs is drawn."""
        return State(layers, self.goal, self, self.over)

    def with_outlines(self, changed: Mapping[int, Parameters]) -> State:
        """The state with other outlines by their numbers; itself where there are none."""
        if not changed:
            return self
        same = all(len(outline.lines) == len(self.outlines[k].lines) for k, outline in changed.items())
        return State(self.layers_with(changed), self.goal, self, self.over, changed if same else None)

    def layers_with(self, changed: Mapping[int, Parameters]) -> list[Layer]:
        """The layers with other outlines by their numbers."""
        layers = list(self.layers)
        for k, outline in changed.items():
            number, place = self.places[k]
            if layers[number] is self.layers[number]:
                layers[number] = replace(layers[number], outlines=list(layers[number].outlines))
            layers[number].outlines[place] = outline
        return layers

    @cached_property
    def clockwise(self) -> np.ndarray:
        """(outlines,) bool, as seen, by the area."""
        return np.bincount(self.owners, areas_beside(self.drawn.cubics), len(self.outlines)) > 0.0

    @cached_property
    def marks(self) -> np.ndarray:
        """(outlines + 1,) where the crossings of each outline begin."""
        return np.searchsorted(self.stack.crossings.piece, self.pieces)

    @property
    def image(self) -> np.ndarray:
        """(H, W, 4) what the layers draw."""
        return self.stack.picture[0]

    @cached_property
    def misfit(self) -> np.ndarray:
        """(H W,) of every pixel."""
        return self.stack.picture[1].ravel()

    @property
    def spread(self) -> int:
        """Px by which the goal's blur carries most of a pixel's change, 0 without one."""
        return -(-self.goal.reach // 2)

    def growth(self, after: State, which: np.ndarray, spread: int, *, leaks: bool = False) -> np.ndarray:
        """Return (outlines,) by how much the misfit, and with `leaks` the value, grows on the pixels within `spread` px
        of those that some outlines (outlines,) bool cross before or after; 0 for the others."""
        before, later = (np.where(which[owners], owners, -1) for owners in (self.owners, after.owners))
        return self.stack.growth(after.stack, before, later, len(which), spread, leaks)

    @cached_property
    def chance(self) -> np.ndarray:
        """(m,) the misfit that the pixels of the crossings have by chance. A blur spreads what an outline does to
        either side of it; along the outline it hardly changes anything."""
        taps = self.goal.taps
        left = float(2.0 * (taps**2).sum() - taps[0] ** 2)  # of a crossing's change, in squares; 1 without a blur
        chance = self.goal.share_error**2 * left * self.effects + self.goal.error**2 + ROUNDING
        return chance if self.goal.banded is None else chance + BANDED * self.goal.banded[self.stack.crossings.pixel]

    @cached_property
    def effects(self) -> np.ndarray:
        """(m,) the squares of how much the pixels of the crossings change with their coverage."""
        return summed((self.stack.crossings.slope * WHITE) ** 2)

    @cached_property
    def floors(self) -> np.ndarray:
        """(outlines,) the misfit that the pixels which each crosses have by chance, the median of these."""
        sizes = np.diff(self.marks)
        order = np.lexsort((self.chance, self.owners[self.stack.crossings.piece]))
        middle = np.stack([self.marks[:-1] + (sizes - 1) // 2, self.marks[:-1] + sizes // 2])
        floors, crossed = np.full(len(sizes), ROUNDING), sizes > 0
        floors[crossed] = self.chance[order[middle[:, crossed]]].mean(axis=0)
        return floors

    def gains(self, after: State, which: np.ndarray) -> np.ndarray:
        """Return (outlines,) by how much half of chi^2 falls on the pixels that some outlines (outlines,) bool cross
        before or after, and beside these: an edge that has moved from one row's border to the next crosses neither; 0
        for the others."""
        return -0.5 * self.growth(after, which, max(1, self.spread)) / self.floors


def goal_of(
    target: np.ndarray,
    blur: float = 0.0,
    space: np.ndarray | None = None,
    share_error: float = FEW_SAMPLES,
    error: float = 0.0,
    banded: np.ndarray | None = None,
) -> Goal:
    """The goal of a drawing: a picture (H, W, 4) premultiplied in [0, 1], blurred by a Gaussian of so many px
    since it was drawn, and compared in other coordinates: rows of RGBA times `space` (4, 4).
    share_error: of the shares of pixels that shapes cover; error: of pixels on edges, of full scale; banded: (H, W)
    bool, pixels of shading, whose fills are bands.
    """
    reach = math.ceil(BLUR_REACH * blur)
    taps = np.exp(-0.5 * (np.arange(reach + 1) / max(blur, 1e-9)) ** 2)
    taps /= 2.0 * taps.sum() - taps[0]
    space = np.eye(4) if space is None else space
    target = np.ascontiguousarray(target @ space, dtype=np.float64)
    bound = max(HUBER, ERRORS * share_error)
    half = _half_contrast(target) if share_error > FEW_SAMPLES else None
    steep = (share_error / FEW_SAMPLES) ** 2
    bands = banded.ravel() if banded is not None and banded.any() else None
    return Goal(target, WHITE.tolist(), bound, 0, taps, space, LEAK_WEIGHT, share_error, error, half, steep, bands)


def _half_contrast(target: np.ndarray) -> np.ndarray:
    """Return (H, W) half of the contrast near each pixel of a target (H, W, 4), as a weighted residual. Without
    anti-aliasing a pixel is on the wrong side of an edge if its residual is larger.
    """
    contrast = ndimage.ranges((target * WHITE).astype(np.float32), (NEAR, NEAR, 1))
    return np.maximum(0.5 * np.linalg.norm(contrast, axis=2), FAINT_EDGE).astype(float)


def begin(drawing: Drawing, goal: Goal, pins: Pins = NO_PINS) -> State:
    """The state of a drawing against its picture; what is pinned stays where it is."""
    return State(layers_of(drawing, goal, pins), goal)


def layers_of(drawing: Drawing, goal: Goal, pins: Pins = NO_PINS) -> list[Layer]:
    """The layers of a drawing; what is pinned stays where it is."""
    constraints = Constraints(drawing.width, drawing.height, pins)
    return [layer_of(shape, goal, [parametrised(o, constraints) for o in shape.outlines]) for shape in drawing.shapes]


def drawn(drawing: Drawing, state: State) -> Drawing:
    """The drawing with the outlines of a state."""
    return replace(drawing, shapes=tuple(layer.drawn() for layer in state.layers))


def premultiplied(fill: Rgba) -> np.ndarray:
    """(4,) in [0, 1] a fill of 8 bits."""
    r, g, b, a = (v / 255.0 for v in fill)
    return np.array([r * a, g * a, b * a, a])


def layer_of(shape: Shape, goal: Goal, outlines: list[Parameters]) -> Layer:
    """The layer of a shape with its outlines, the outer one first, in the coordinates of a goal."""
    areas = [areas_beside(outline.cubics - outline.cubics[0, 0]).sum() for outline in outlines]
    signs = [1.0 if (area > 0.0) == (i == 0) else -1.0 for i, area in enumerate(areas)]
    return Layer(shape, premultiplied(shape.fill) @ goal.space, outlines, signs)


def still_layer(shape: Shape, goal: Goal) -> Layer:
    """The layer of a shape that stays as it is."""
    return layer_of(shape, goal, [*map(Still, shape.outlines)])
