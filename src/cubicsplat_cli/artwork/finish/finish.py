"""The finish: all free parameters of the drawing optimised against the pixels, through their exact coverage.

The picture of a stack of shapes is composed pixel by pixel from exact coverages, as the engines and SVG viewers do. Its
derivative by every parameter is as exact, so damped Gauss-Newton needs few steps where gradient descent takes hundreds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cubicsplat_cli.artwork.finish.freedom import NO_PINS, CopyFreedom, Freedom, Held, Pins, freedom_of
from cubicsplat_cli.artwork.finish.seals import leak_misfit, leaks, sealed_equations
from cubicsplat_cli.artwork.geometry.outlines import Ring, signed_area
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.stack import CoverageJacobian, Goal, StackPieces, draw_stack
from cubicsplat_cli.scene.paint import Ink

ROUNDS = 14
# Pixels are known to this fraction of full scale; parameters that no pixel sees stay to within FREE px.
PIXEL_SIGMA, FREE = 0.02, 0.5
HUBER = 0.15  # residuals beyond count linearly: they are details that no shape draws
ENOUGH = 2e-3  # relative gain of a round below which it is finished
# Damping of outlines at the start, beyond which a step has just failed, and from which none will help.
START, RELAXED, HOPELESS = 1e-3, 5e-3, 1e3
TAKEN_BACK, SAME = 3, 1e-12  # times that outlines are taken back after a step, for a misfit that has grown by more
BLUR_REACH = 3.0  # standard deviations of a blur, beyond which nothing is left of it
LONGEST = 1.5  # px that a control point moves at most in a step
WHITE = np.sqrt(np.array([1.0, 1.0, 1.0, 2.0]))  # weight of the channels, so that opacity counts over white as well


@dataclass
class Layer:
    """A shape while it is optimised. ink: (4,) premultiplied, in the goal's coordinates; signs:
    (outlines,) +1 where a ring runs as it must."""

    shape: Shape
    ink: np.ndarray
    outlines: list[Freedom]
    signs: list[float]


@dataclass
class State:
    """A drawing against its picture. layers: back to front; image: (H, W, 4) what they draw; misfit: (H W,) of every
    pixel; leaking: (k,) pixels at which the ground shows where the picture is opaque (`seals`); cost: the misfit and
    what they add; crossings: of its pieces, numbered through all outlines; pieces, marks: (outlines + 1,) where those
    of each outline begin; sharing: how much of what a crossing changes is left by the goal's blur, in squares, 1
    without one; spread: px by which that carries most of a pixel's change, 0 without one.
    """

    layers: list[Layer]
    image: np.ndarray
    misfit: np.ndarray
    leaking: np.ndarray
    cost: np.ndarray
    crossings: CoverageJacobian
    pieces: np.ndarray
    marks: np.ndarray
    sharing: float
    spread: int

    @classmethod
    def of(cls, layers: list[Layer], goal: Goal) -> State:
        outlines = [o for layer in layers for o in layer.outlines]
        sizes = [len(o.lines) for o in outlines]
        pieces = np.cumsum([0, *sizes])
        ends = pieces[np.cumsum([len(layer.outlines) for layer in layers])].astype(np.int32)
        signs = np.repeat([sign for layer in layers for sign in layer.signs], sizes)
        stack = StackPieces(
            ends,
            np.concatenate([o.cubics for o in outlines]),
            np.concatenate([o.lines for o in outlines]),
            signs,
            np.array([layer.ink for layer in layers]),
        )
        image, misfit, crossings = draw_stack(stack, goal)
        marks = np.searchsorted(crossings.piece, pieces)
        # A blur spreads what an outline does to either side of it; along the outline it hardly changes anything.
        sharing = float(2.0 * (goal.taps**2).sum() - goal.taps[0] ** 2)
        leaking, misfit, spread = leaks(image, goal), misfit.ravel(), -(-goal.reach // 2)
        cost = misfit
        if len(leaking):
            cost = misfit.copy()
            cost[leaking] += leak_misfit(image, leaking)
        return cls(layers, image, misfit, leaking, cost, crossings, pieces, marks, sharing, spread)

    @property
    def value(self) -> float:
        return float(self.cost.sum())

    def crossed(self, number: int) -> np.ndarray:
        """The pixels that an outline changes: those that it crosses, some of them twice, and what a blur adds."""
        return self.changed(slice(self.marks[number], self.marks[number + 1]))

    def changed(self, own: slice | np.ndarray) -> np.ndarray:
        """The pixels that some of the crossings change."""
        pixel = self.crossings.pixel[own]
        if not self.spread or not len(pixel):
            return pixel
        height, width = self.image.shape[:2]
        y, x = np.divmod(pixel, width)
        top, left = max(y.min() - self.spread, 0), max(x.min() - self.spread, 0)
        bottom, right = min(y.max() + self.spread + 1, height), min(x.max() + self.spread + 1, width)
        marked = np.zeros((bottom - top, right - left), dtype=bool)
        marked[y - top, x - left] = True
        y, x = np.nonzero(ndimage.maximum_filter(marked, 2 * self.spread + 1))
        return (y + top) * width + x + left


def goal_of(target: np.ndarray, blur: float = 0.0, space: np.ndarray | None = None) -> Goal:
    """What a drawing is fitted to: a picture (H, W, 4) premultiplied in [0, 1], blurred by a Gaussian of so many px
    since it was drawn, and compared in other coordinates: rows of RGBA times `space` (4, 4).
    """
    reach = math.ceil(BLUR_REACH * blur)
    taps = np.exp(-0.5 * (np.arange(reach + 1) / max(blur, 1e-9)) ** 2)
    taps /= 2.0 * taps.sum() - taps[0]
    space = np.eye(4) if space is None else space
    return Goal(np.ascontiguousarray(target @ space, dtype=np.float64), WHITE.tolist(), HUBER, 0, taps, space)


def begin(drawing: Drawing, goal: Goal, pins: Pins = NO_PINS) -> State:
    """The state of a drawing against its picture; what is pinned stays where it is."""
    held = Held(drawing.width, drawing.height, pins)
    return State.of([_layer(shape, held, goal.space) for shape in drawing.shapes], goal)


def settle(state: State, goal: Goal, rounds: int = ROUNDS, *, trim: bool = True) -> State:
    """The nearest state to the picture that has the same pieces; trim: less those that become too short to matter."""
    damping = np.full(sum(len(layer.outlines) for layer in state.layers), START)
    for _ in range(rounds):
        work().at()
        following = _improved(state, goal, damping)
        gain = state.value - following.value
        state = _trimmed(following, goal) if trim else following
        if gain < ENOUGH * state.value and not ((damping > RELAXED) & (damping < HOPELESS)).any():
            break
    return state


def drawn(drawing: Drawing, state: State) -> Drawing:
    """The drawing with the outlines of a state."""
    shapes = [replace(layer.shape, outlines=tuple(o.outline() for o in layer.outlines)) for layer in state.layers]
    return replace(drawing, shapes=tuple(shapes))


def _improved(state: State, goal: Goal, damping: np.ndarray) -> State:
    """The state after a step, without the outlines that fit their own pixels worse by it; `damping` is brought up to
    date in place.

    What one outline spoils is held against its neighbours too, so the worst ones are taken back first. Copies are
    judged together with their model.
    """
    families = np.array(_families(state.layers))
    layers = _stepped(state.layers, *_normal_equations(state, goal), damping)
    refused = np.zeros(len(damping), dtype=bool)
    for left in reversed(range(TAKEN_BACK + 1)):
        trial = State.of(kept(state.layers, layers, refused), goal)
        loss = np.bincount(families, _losses(state, trial), len(families))[families]
        loss = np.where(refused, 0.0, loss)
        if left == 0 or not (loss > SAME).any():
            break
        refused |= loss > (SAME if left == 1 else 0.2 * loss.max())
    damping[:] = np.where(refused, np.minimum(damping * 10.0, 10.0 * HOPELESS), np.maximum(damping / 5.0, 1e-6))
    if trial.value < state.value:
        return trial
    damping *= 10.0
    return state


def _trimmed(state: State, goal: Goal) -> State:
    """The state without pieces that have become too short to matter."""
    layers = [replace(layer, outlines=[o.trimmed() for o in layer.outlines]) for layer in state.layers]
    kept = [o for layer in state.layers for o in layer.outlines]
    same = all(a is b for a, b in zip(kept, (o for layer in layers for o in layer.outlines), strict=True))
    return state if same else State.of(layers, goal)


def _losses(old: State, new: State) -> np.ndarray:
    """(outlines,) by how much the cost has grown on the pixels that an outline crosses before or after a step."""
    count, size = len(old.marks) - 1, len(old.cost)
    touched = [state.crossed(k).astype(np.int64) + k * size for k in range(count) for state in (old, new)]
    keys = np.sort(np.concatenate(touched))
    number, pixel = np.divmod(keys[np.diff(keys, prepend=-1) > 0], size)
    return np.bincount(number, new.cost[pixel] - old.cost[pixel], count)


def kept(old: list[Layer], new: list[Layer], worse: np.ndarray) -> list[Layer]:
    """The new layers, with the old outlines where the new ones are worse."""
    refused = iter(worse.tolist())
    return [
        replace(b, outlines=[x if next(refused) else y for x, y in zip(a.outlines, b.outlines, strict=True)])
        for a, b in zip(old, new, strict=True)
    ]


def _layer(shape: Shape, held: Held, space: np.ndarray) -> Layer:
    ink = premultiplied(shape.ink) @ space
    return layer_of(shape, ink, [freedom_of(outline, held) for outline in shape.outlines])


def premultiplied(ink: Ink) -> np.ndarray:
    """(4,) in [0, 1] an ink of 8 bits."""
    r, g, b, a = (v / 255.0 for v in ink)
    return np.array([r * a, g * a, b * a, a])


def layer_of(shape: Shape, ink: np.ndarray, outlines: list[Freedom]) -> Layer:
    """The layer of a shape with its outlines, the outer one first."""
    signs = []
    for i, outline in enumerate(outlines):
        ring = Ring(outline.cubics[:, 0], outline.cubics[:, 1:3], outline.lines, outline.lines)
        signs.append(1.0 if (signed_area(ring) > 0.0) == (i == 0) else -1.0)
    return Layer(shape, ink, outlines, signs)


def _families(layers: list[Layer]) -> list[int]:
    """Of each outline whose variables move it: the number of its model, or its own."""
    outlines = [o for layer in layers for o in layer.outlines]
    return [o.source if isinstance(o, CopyFreedom) else k for k, o in enumerate(outlines)]


def _normal_equations(state: State, goal: Goal) -> tuple[sparse.csc_matrix, np.ndarray, list[int]]:
    """Gram matrix, gradient, and the first variable of each outline, the number of variables last; copies have none."""
    parts = [o.jacobian for layer in state.layers for o in layer.outlines]
    families = _families(state.layers)
    own = [part.shape[1] if k == family else 0 for k, (family, part) in enumerate(zip(families, parts, strict=True))]
    starts = np.cumsum([0, *own]).tolist()
    values = np.concatenate([part.data for part in parts])
    columns = np.concatenate([part.indices + starts[family] for part, family in zip(parts, families, strict=True)])
    ends = np.cumsum([0, *(part.nnz for part in parts)])
    rows = np.concatenate([[0], *(part.indptr[1:] + end for part, end in zip(parts, ends, strict=False))])
    jacobian = sparse.csr_matrix((values, columns, rows), shape=(8 * int(state.pieces[-1]), starts[-1]))
    gram, gradient = sealed_equations(goal, state.image, state.crossings, int(state.pieces[-1]), state.leaking)
    return (jacobian.T @ (gram.tocsr() @ jacobian)).tocsc(), jacobian.T @ gradient, starts


def _stepped(
    layers: list[Layer], gram: sparse.csc_matrix, gradient: np.ndarray, starts: list[int], damping: np.ndarray
) -> list[Layer]:
    keep = (PIXEL_SIGMA / FREE) ** 2 + np.repeat(damping, np.diff(starts)) * gram.diagonal()
    step = splu((gram + sparse.diags(keep)).tocsc()).solve(-gradient)
    moved: list[Freedom] = []
    for number, outline in enumerate(o for layer in layers for o in layer.outlines):
        own = step[starts[number] : starts[number + 1]]
        reach = np.abs(outline.jacobian @ own).max(initial=0.0) if len(own) else 0.0
        moved.append(outline.moved(own * min(1.0, LONGEST / max(reach, 1e-12))) if len(own) else outline)
    following = iter([o.following(moved[o.source]) if isinstance(o, CopyFreedom) else o for o in moved])
    return [replace(layer, outlines=[next(following) for _ in layer.outlines]) for layer in layers]
