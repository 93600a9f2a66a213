"""The finish: all free parameters of the drawing optimised against the pixels, through their exact coverage.

The picture of a stack of shapes is composed pixel by pixel from exact coverages, as the engines and SVG viewers do. Its
derivative by every parameter is as exact, so damped Gauss-Newton needs few steps where gradient descent takes hundreds.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cubicsplat_cli.artwork.coverage import Edges, coverage, edges_of
from cubicsplat_cli.artwork.freedom import Freedom, freedom_of
from cubicsplat_cli.artwork.outlines import Ring, signed_area
from cubicsplat_cli.artwork.shapes import Drawing, Shape

ROUNDS = 14
# Pixels are known to this fraction of full scale; parameters that no pixel sees stay to within FREE px.
PIXEL_SIGMA, FREE = 0.02, 0.5
HUBER = 0.15  # residuals beyond count linearly: they are details that no shape draws
ENOUGH = 2e-3  # relative gain of a round below which it is finished
# Damping of outlines at the start, beyond which a step has just failed, and from which none will help.
START, RELAXED, HOPELESS = 1e-3, 1e-2, 1e3
LONGEST = 1.5  # px that a control point moves at most in a step
WHITE = np.sqrt(np.array([1.0, 1.0, 1.0, 2.0]))  # weight of the channels, so that opacity counts over white as well


@dataclass
class Layer:
    """A shape while it is optimised. ink: (4,) premultiplied; signs: (outlines,) +1 where a ring runs as it must."""

    shape: Shape
    ink: np.ndarray
    outlines: list[Freedom]
    signs: list[float]

    def traced(self) -> tuple[Edges, np.ndarray]:
        """The edges of all outlines, and which of them run the wrong way round, as factors (m,)."""
        cubics = np.concatenate([o.cubics for o in self.outlines])
        lines = np.concatenate([o.lines for o in self.outlines])
        sign = np.repeat(self.signs, [len(o.lines) for o in self.outlines])
        edges = edges_of(cubics, lines)
        factor = sign[edges.cubic]
        return replace(edges, step=edges.step * factor[:, None]), factor


@dataclass
class View:
    """What one layer contributes: its edges on the canvas, flat: (m,) their pixels; pixels: (n,) those,
    each once; slope: (n, 4) what a coverage there changes."""

    edges: Edges
    flat: np.ndarray
    pixels: np.ndarray
    slope: np.ndarray

    def of(self, layer: Layer, k: int) -> np.ndarray:
        """The pixels that the k-th outline of its layer crosses, each edge's."""
        sizes = np.cumsum([0] + [len(o.lines) for o in layer.outlines])
        return self.flat[(self.edges.cubic >= sizes[k]) & (self.edges.cubic < sizes[k + 1])]


@dataclass
class State:
    """A drawing against its picture. layers: back to front; image: (H, W, 4) what they draw; views: what each
    contributes; misfit: (H W,) of every pixel.
    """

    layers: list[Layer]
    image: np.ndarray
    views: list[View]
    misfit: np.ndarray

    @classmethod
    def of(cls, layers: list[Layer], target: np.ndarray) -> State:
        image, views = _compose(layers, target.shape[:2])
        return cls(layers, image, views, _misfit(image, target).ravel())

    @property
    def value(self) -> float:
        return float(self.misfit.sum())


def begin(drawing: Drawing, target: np.ndarray) -> State:
    """The state of a drawing against a picture (H, W, 4) premultiplied in [0, 1]."""
    return State.of([_layer(shape, drawing) for shape in drawing.shapes], target)


def settle(state: State, target: np.ndarray, rounds: int = ROUNDS) -> State:
    """The nearest state to the picture that has the same pieces."""
    damping = np.full(sum(len(layer.outlines) for layer in state.layers), START)
    for _ in range(rounds):
        following = _improved(state, target, damping)
        gain = state.value - following.value
        state = _trimmed(following, target)
        if gain < ENOUGH * state.value and not ((damping > RELAXED) & (damping < HOPELESS)).any():
            break
    return state


def drawn(drawing: Drawing, state: State) -> Drawing:
    """The drawing with the outlines of a state."""
    shapes = [replace(layer.shape, outlines=tuple(o.outline() for o in layer.outlines)) for layer in state.layers]
    return replace(drawing, shapes=tuple(shapes))


def _improved(state: State, target: np.ndarray, damping: np.ndarray) -> State:
    """The state after a step, without the outlines that fit their own pixels worse by it; `damping` is brought up to
    date in place.
    """
    layers = _stepped(state.layers, *_normal_equations(state, target), damping)
    trial = State.of(layers, target)
    worse = _worse(state, trial)
    damping[:] = np.where(worse, np.minimum(damping * 10.0, 10.0 * HOPELESS), np.maximum(damping / 5.0, 1e-6))
    if worse.any():
        trial = State.of(kept(state.layers, layers, worse), target)
    if trial.value < state.value:
        return trial
    damping *= 10.0
    return state


def _trimmed(state: State, target: np.ndarray) -> State:
    """The state without pieces that have become too short to matter."""
    layers = [replace(layer, outlines=[o.trimmed() for o in layer.outlines]) for layer in state.layers]
    kept = [o for layer in state.layers for o in layer.outlines]
    same = all(a is b for a, b in zip(kept, (o for layer in layers for o in layer.outlines), strict=True))
    return state if same else State.of(layers, target)


def _worse(old: State, new: State) -> np.ndarray:
    """(outlines,) bool: the misfit on the pixels that an outline crosses before or after a step has grown."""
    out = []
    for a, b, layer in zip(old.views, new.views, old.layers, strict=True):
        for k in range(len(layer.outlines)):
            pixels = np.union1d(a.of(layer, k), b.of(layer, k))
            out.append(float(new.misfit[pixels].sum()) > float(old.misfit[pixels].sum()) + 1e-12)
    return np.array(out)


def kept(old: list[Layer], new: list[Layer], worse: np.ndarray) -> list[Layer]:
    """The new layers, with the old outlines where the new ones are worse."""
    refused = iter(worse.tolist())
    return [
        replace(b, outlines=[x if next(refused) else y for x, y in zip(a.outlines, b.outlines, strict=True)])
        for a, b in zip(old, new, strict=True)
    ]


def _layer(shape: Shape, drawing: Drawing) -> Layer:
    r, g, b, a = (v / 255.0 for v in shape.ink)
    outlines = [freedom_of(outline, drawing.width, drawing.height) for outline in shape.outlines]
    signs = []
    for i, outline in enumerate(outlines):
        ring = Ring(outline.cubics[:, 0], outline.cubics[:, 1:3], outline.lines, outline.lines)
        signs.append(1.0 if (signed_area(ring) > 0.0) == (i == 0) else -1.0)
    return Layer(shape, np.array([r * a, g * a, b * a, a]), outlines, signs)


def _compose(layers: list[Layer], size: tuple[int, int]) -> tuple[np.ndarray, list[View]]:
    """The picture (H, W, 4), and what each layer contributes to it."""
    height, width = size
    image = np.zeros((height, width, 4))
    flat = image.reshape(-1, 4)
    views, windows = [], []
    for layer in layers:
        edges, _ = layer.traced()
        on = (edges.row >= 0) & (edges.row < height) & (edges.column >= 0) & (edges.column < width)
        top, bottom = _range(edges.row, height)
        left, right = _range(edges.column, width)
        share = coverage(edges, top, left, bottom - top, right - left)
        seen = Edges(edges.cubic[on], edges.t[on], edges.row[on], edges.column[on], edges.step[on], edges.middle[on])
        own = seen.row * width + seen.column
        pixels = np.unique(own)
        views.append(View(seen, own, pixels, layer.ink - layer.ink[3] * flat[pixels]))
        window = image[top:bottom, left:right]
        window *= (1.0 - layer.ink[3] * share)[..., None]
        window += share[..., None] * layer.ink
        windows.append((slice(top, bottom), slice(left, right), 1.0 - layer.ink[3] * share))
    open_to = np.ones((height, width))
    for view, (rows, columns, passing) in zip(reversed(views), reversed(windows), strict=True):
        view.slope *= open_to.reshape(-1)[view.pixels, None]
        open_to[rows, columns] *= passing
    return image, views


def _range(values: np.ndarray, most: int) -> tuple[int, int]:
    low = int(np.clip(values.min(initial=most), 0, most - 1))
    return low, int(np.clip(values.max(initial=0) + 1, low + 1, most))


def _misfit(image: np.ndarray, target: np.ndarray) -> np.ndarray:
    size = np.sqrt((((image - target) * WHITE) ** 2).sum(axis=-1))
    return np.where(size <= HUBER, size * size, HUBER * (2.0 * size - HUBER))


def _normal_equations(state: State, target: np.ndarray) -> tuple[sparse.csc_matrix, np.ndarray, list[int]]:
    """Gram matrix, gradient, and the first variable of each outline, the number of variables last."""
    rest = ((state.image - target) * WHITE).reshape(-1, 4)
    size = np.sqrt((rest * rest).sum(axis=1))
    weight = np.sqrt(np.minimum(1.0, HUBER / np.maximum(size, 1e-12)))
    blocks, starts = [], [0]
    for layer, view in zip(state.layers, state.views, strict=True):
        parts = [o.jacobian() for o in layer.outlines]
        jacobian = sparse.block_diag(parts, format="csr")
        change = (_coverage_change(view, jacobian.shape[0]) @ jacobian).tocoo()
        slope = view.slope * WHITE * weight[view.pixels, None]
        for c in range(4):
            value = change.data * slope[change.row, c]
            blocks.append((view.pixels[change.row] * 4 + c, change.col + starts[-1], value))
        for part in parts:
            starts.append(starts[-1] + part.shape[1])
    rows, columns, values = (np.concatenate(part) for part in zip(*blocks, strict=True))
    used, rows = np.unique(rows, return_inverse=True)
    matrix = sparse.csr_matrix((values, (rows.reshape(-1), columns)), shape=(len(used), starts[-1]))
    seen = (rest * weight[:, None]).reshape(-1)[used]
    return (matrix.T @ matrix).tocsc(), matrix.T @ seen, starts


def _coverage_change(view: View, coordinates: int) -> sparse.csr_matrix:
    """(pixels, coordinates) how the coverages of a layer's pixels change with its control points' coordinates."""
    e, width = view.edges, len(view.pixels)
    s = 1.0 - e.t
    basis = np.stack([s**3, 3.0 * s * s * e.t, 3.0 * s * e.t * e.t, e.t**3], axis=1)
    normal = np.stack([e.step[:, 1], -e.step[:, 0]], axis=1)
    values = basis[:, :, None] * normal[:, None, :]
    columns = 8 * e.cubic[:, None] + np.arange(8)
    rows = np.broadcast_to(np.searchsorted(view.pixels, view.flat)[:, None], columns.shape)
    return sparse.csr_matrix((values.ravel(), (rows.ravel(), columns.ravel())), shape=(width, coordinates))


def _stepped(
    layers: list[Layer], gram: sparse.csc_matrix, gradient: np.ndarray, starts: list[int], damping: np.ndarray
) -> list[Layer]:
    keep = (PIXEL_SIGMA / FREE) ** 2 + np.repeat(damping, np.diff(starts)) * gram.diagonal()
    step = splu((gram + sparse.diags(keep)).tocsc()).solve(-gradient)
    moved, number = [], 0
    for layer in layers:
        outlines = []
        for outline in layer.outlines:
            own = step[starts[number] : starts[number + 1]]
            reach = np.abs(outline.jacobian() @ own).max(initial=0.0)
            outlines.append(outline.moved(own * min(1.0, LONGEST / max(reach, 1e-12))))
            number += 1
        moved.append(replace(layer, outlines=outlines))
    return moved
