"""The fills of a drawing at their best for its picture, once its gradients are what they are.

Regions are found in a picture where one colour, a placeholder, stands for each gradient. Shapes at the edge of a
gradient may have got some of that colour, and shapes of a colour like that the gradient itself.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import cached_property

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.flattening import Flattened, colours_of
from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA
from cubicsplat_cli.artwork.gradients.shade import CLOSE, SHARE, gradient_of
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.input.palette import UNLIKE
from cubicsplat_cli.artwork.regions.fills import eight_bit
from cubicsplat_cli.artwork.scene import scene_of
from cubicsplat_cli.artwork.shapes import FILL_PARAMETERS, PRICE, Drawing, Shape
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.shades import Pixels
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Gradient, Paint, Rgba, is_opaque

ALONE = 0.99  # share of a pixel from which it shows a shape alone
ROUNDED = 1.0 / 12.0  # levels^2 by which a picture's pixels are off at the least


def recoloured(drawing: Drawing, levels: np.ndarray, flat: Flattened | None, *, simpler: bool = False) -> Drawing:
    """The drawing with other opaque paints where the description of its picture (H, W, 4), premultiplied levels,
    becomes shorter by them: normal errors of any one size in the pixels of a shape, against the price of a paint. These
    are a fill, where there are gradients, the gradients of other shapes, and one of its own. flat: the gradients of a
    damaged picture, whose fills are only freed of what stands for these; None for a clean one. simpler: whether the
    drawing is a simpler version, which gets no gradients that it has not.
    """
    shaded = bool(drawing.gradients)
    if not drawing.shapes or (flat is not None and not shaded):
        return drawing
    height, width = levels.shape[:2]
    off = (levels - 255.0 * render_scene(scene_of(drawing)))[..., :3]
    seen, shapes = np.ones((height, width)), list(drawing.shapes)
    others = list(dict.fromkeys(shape.gradient for shape in shapes if shape.gradient and is_opaque(shape.gradient)))
    for k, shape in reversed(list(enumerate(shapes))):
        window, own = shape.covered(seen.shape)
        top, left = window[0].start, window[1].start
        share = own * seen[window]
        seen[window] *= 1.0 - own * (shape.fill[3] / 255.0)
        y, x = np.nonzero(share)
        # A damaged picture does not tell the colours of thin shapes well enough to give up their gradients.
        damaged = flat is not None and shape.gradient is not None
        if damaged or not len(y) or not is_opaque(shape.paint):
            continue
        shown = _Shown(x + left, y + top, share[y, x][:, None], off[window][y, x], shape)
        paints: list[tuple[Paint, float]] = [*(shown.fills(flat) if shaded else ())]
        if flat is None and shape.stroke is None:
            # The errors of neighbouring pixels depend on each other, so that a gradient has to save more.
            paints += ((each, FILL_PARAMETERS / SHARE) for each in others if each != shape.gradient)
            paints += () if simpler else shown.gradient(levels)
        lengths = [shown.length(shape.paint), *(shown.length(*paint) for paint in paints)]
        if best := int(np.argmin(lengths)):
            paint = paints[best - 1][0]
            off[window][y, x] = shown.left(paint)
            shapes[k] = shape.filled(paint, width, height)
    return replace(drawing, shapes=tuple(shapes))


@record
class _Shown:
    """What is seen of an opaque shape. x, y: (n,) its columns and rows; share: (n, 1) of each pixel; off: (n, 3) levels
    that the picture is above the drawing."""

    x: np.ndarray
    y: np.ndarray
    share: np.ndarray
    off: np.ndarray
    shape: Shape

    def colours(self, paint: Paint) -> np.ndarray:
        """Return the levels (n, 3) or (3,) of a paint."""
        if isinstance(paint, tuple):
            return np.array(paint[:3], dtype=float)
        return colours_of((paint,), self.x, self.y)[:, :3]

    @cached_property
    def wanted(self) -> np.ndarray:
        """(n, 3) levels, times the share, of a paint that leaves no error."""
        return self.off + self.share * self.colours(self.shape.paint)

    def left(self, paint: Paint) -> np.ndarray:
        """Return (n, 3) levels that the picture is above the drawing with another paint."""
        return self.wanted - self.share * self.colours(paint)

    def length(self, paint: Paint, parameters: float = 0.0) -> float:
        """Return the description length in nats of the errors with a paint, and of its parameters."""
        left = self.left(paint)
        return 0.5 * left.size * math.log(float((left**2).mean()) + ROUNDED) + PRICE * parameters

    def fills(self, flat: Flattened | None) -> Iterator[tuple[Rgba, float]]:
        """Yield the best fill, if it may be another one, and its parameters. flat: as of `recoloured`."""
        best = (self.share * self.wanted).sum(axis=0) / (self.share**2).sum()
        if flat is not None:
            fill = self.colours(self.shape.fill)
            change = _leak(best - fill, flat, self.x, self.y)
            if np.abs(change).max() < UNLIKE:
                return
            best = fill + change
        yield eight_bit(np.append(best, 255.0)), FILL_PARAMETERS

    def gradient(self, levels: np.ndarray) -> Iterator[tuple[Gradient, float]]:
        """Yield the gradient of the pixels (H, W, 4) in levels that show the shape alone, and its parameters; none if
        they are few, or most are in the paint that it has: what is left of halos beside edges is no gradient."""
        alone = self.share[:, 0] > ALONE
        if alone.sum() < LEAST_AREA or float(np.median(largest(np.abs(self.off[alone])))) <= CLOSE:
            return
        x, y = self.x[alone], self.y[alone]
        shade = shade_of(Pixels(x + 0.5, y + 0.5, levels[y, x].astype(float)))
        yield gradient_of(shade), shade.price / (PRICE * SHARE)


def _leak(change: np.ndarray, flat: Flattened, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return the part of a change (3,) of a fill that takes out the share of a placeholder, of the one that explains
    most of the change, at columns and rows (n,); 0 if it leaves half of the change."""
    best = np.zeros(3)
    for fill, gradients in zip(flat.fills, flat.gradients, strict=True):
        whole = colours_of(gradients, x, y)[:, :3].mean(axis=0) - fill[:3]
        part = whole * np.clip(change @ whole / max(float(whole @ whole), 1e-9), 0.0, 1.0)
        best = min(best, part, key=lambda each: float(((change - each) ** 2).sum()))
    # Of many placeholders, some one explains a part of any change.
    return best if np.linalg.norm(change - best) < 0.5 * np.linalg.norm(change) else np.zeros(3)
