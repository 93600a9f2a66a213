"""Gradients as they are fitted: a geometry, a ramp of colours along it, and the pixels that show it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.parts import Patch, joined
from cubicsplat_cli.artwork.regions.fills import EVEN, SEEN, eight_bit
from cubicsplat_cli.artwork.shapes import PRICE
from cubicsplat_cli.raster.shades import GradientArrays, Pixels, best_colours, colours_at, colours_off
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Rgba, Stop, laid_over, parameter, radial_of_frame

CLOSE = 2.0  # levels by which a gradient may differ from a pixel that it explains
SIGMA = 0.4  # levels, standard deviation of rounding to 8 bits and of the arithmetic of drawing programs
SHARE = 0.2  # weight of a pixel, since the errors of neighbouring pixels depend on each other
MOST_CHI = 36.0  # chi^2 of a pixel at most, so that outliers count little
STOP_PARAMETERS = 4  # a place and a colour, most often opaque


@record
class Ramp:
    """knots: (K,) ascending t; colours: (K, 4) levels there."""

    knots: np.ndarray
    colours: np.ndarray

    def at(self, t: np.ndarray) -> np.ndarray:
        """Return the colours (n, 4) at t (n,)."""
        return np.stack([np.interp(t, self.knots, self.colours[:, k]) for k in range(4)], axis=-1)

    def trimmed(self) -> Ramp:
        """Return the ramp without end stops that repeat their neighbours, since a ramp goes on as it ends."""
        changes = np.flatnonzero(np.abs(np.diff(self.colours, axis=0)).max(axis=1) > EVEN)
        first, last = (changes[0], changes[-1]) if len(changes) else (len(self.knots) - 2,) * 2
        return Ramp(self.knots[first : last + 2], self.colours[first : last + 2])


def alike(first: Ramp, second: Ramp) -> float:
    """Return the median distance in levels of the colours of one ramp from the other ramp, whichever is nearer."""
    distances = []
    for one, other in ((first, second), (second, first)):
        here, there = (r.at(np.linspace(r.knots[0], r.knots[-1], n)) for r, n in ((one, 9), (other, 65)))
        distances.append(float(np.median(np.abs(here[:, None] - there).max(axis=2).min(axis=1))))
    return min(distances)


@record
class Shade:
    """A gradient: its frame (2, 4) as of `raster.shades`, and the ramp over its t. radial: t is a length; parameters:
    numbers of the geometry. open: True where no pixel shows that the ramp ends at its first or its last stop."""

    frame: np.ndarray
    radial: bool
    ramp: Ramp
    parameters: int
    open: tuple[bool, bool] = (False, False)

    def t(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return parameter(self.frame, self.radial, x, y)

    def slope(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return the derivatives (2, n) of t per px at places in px."""
        turn, lean = self.frame[:, :2], self.frame[:, 3:]
        if not self.radial:
            return turn[:1].T + np.zeros(len(x))
        u = self.frame[:, :3] @ np.stack([x, y, np.ones(len(x))])
        return turn.T @ (u / np.maximum(np.hypot(*u), 1e-9) + lean)

    @property
    def given(self) -> GradientArrays:
        """Its frame, radial, knots and colours, as `raster.shades` takes them."""
        return self.frame, self.radial, self.ramp.knots, self.ramp.colours

    def at(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """Return premultiplied levels (n, 4) at places in px."""
        return colours_at(self.given, x, y)

    def off(self, pixels: Pixels) -> np.ndarray:
        """Return levels (n,) by which the worst channel of each pixel differs."""
        return largest(np.abs(self.residuals(pixels)))

    def explains(self, pixels: Pixels) -> np.ndarray:
        """Return (n,) bool: True for the pixels that differ by CLOSE at most."""
        return self.off(pixels) <= CLOSE

    def misfit(self, pixels: Pixels, sigma: float = SIGMA) -> float:
        """Return half of the chi^2 of pixels, in nats. sigma: levels, the standard deviation of their errors."""
        residuals = self.residuals(pixels)
        chi = np.einsum("nk,nk->n", residuals, residuals) / (sigma * sigma)
        return 0.5 * SHARE * float(np.minimum(chi, MOST_CHI).sum())

    def residuals(self, pixels: Pixels) -> np.ndarray:
        """Return the colours (n, 4) of the shade less those of pixels, in levels."""
        return colours_off(self.given, pixels)

    def stopped(self, knots: np.ndarray, pixels: Pixels) -> Shade:
        """Return the shade with stops at these knots, in the colours nearest to pixels."""
        return replace(self, ramp=Ramp(knots, best_colours(self.frame, self.radial, knots, pixels)))

    def extended(self) -> Shade:
        """Return the shade with its ramp carried on at open ends, by its length."""
        knots, colours = self.ramp.knots.copy(), self.ramp.colours.copy()
        length = knots[-1] - knots[0]
        for end, beside, step in ((0, 1, -length), (-1, -2, length)):
            if self.open[end]:
                colours[end] += step * (colours[end] - colours[beside]) / (knots[end] - knots[beside])
                knots[end] += step
        return replace(self, ramp=Ramp(knots, colours))

    @property
    def price(self) -> float:
        """Description length in nats."""
        return PRICE * (self.parameters + STOP_PARAMETERS * len(self.ramp.knots))


@record
class ShadedArea:
    """A gradient and the pixels that show it. ground: the colour (4,) in levels into which it fades without an edge, or
    None; rim: the stop at which it does, the first (0) or the last (-1); over: gradients above it, back to front."""

    shade: Shade
    patch: Patch
    ground: np.ndarray | None = None
    rim: int = 0
    over: tuple[Shade, ...] = ()

    @property
    def plain(self) -> bool:
        """True if the pixels show the gradient alone."""
        return self.ground is None and not self.over

    @property
    def shades(self) -> tuple[Shade, ...]:
        """All its gradients, back to front."""
        return (self.shade, *self.over)

    def off(self, pixels: Pixels) -> np.ndarray:
        """Return levels (n,) by which the worst channel of each pixel differs from the gradients."""
        return largest(np.abs(shown(self.shades, pixels) - pixels.values))

    def kept(self, where: np.ndarray) -> ShadedArea:
        """Return the area with its pixels in a mask (H, W) bool."""
        return replace(self, patch=replace(self.patch, mask=self.patch.mask & where[self.patch.window]))


def shown(shades: Sequence[Shade], pixels: Pixels) -> np.ndarray:
    """Return the colours (n, 4) of gradients, back to front, at pixels, in premultiplied levels."""
    return laid_over([shade.at(pixels.x, pixels.y) for shade in shades], 255.0)


def covered(areas: Iterable[ShadedArea], shape: tuple[int, ...]) -> np.ndarray:
    """Return (H, W) bool: the pixels of some areas of a picture (H, W, ...)."""
    out = np.zeros(shape[:2], dtype=bool)
    for area in areas:
        out[area.patch.window] |= area.patch.mask
    return out


def by_gradient(areas: Iterable[ShadedArea]) -> list[ShadedArea]:
    """Return for each gradient one area, of the pixels of all its areas."""
    patches_of = dict[Shade, list[Patch]]()
    for area in areas:
        patches_of.setdefault(area.shade, []).append(area.patch)
    return [ShadedArea(shade, joined(patches)) for shade, patches in patches_of.items()]


def gradient_of(shade: Shade) -> Gradient:
    """Return the gradient with 8-bit stops. A linear one has t = 0 at its first stop; any has t = 1 at its last."""
    knots = shade.ramp.knots
    first = knots[0] if not shade.radial else 0.0
    span = max(float(knots[-1] - first), 1e-9)
    stops = tuple(map(Stop, np.clip((knots - first) / span, 0.0, 1.0).tolist(), _fills(shade.ramp.colours)))
    if not shade.radial:
        slope = shade.frame[0, :2]
        square = float(slope @ slope)
        # The ends nearest to the area: the start on the line through the frame's own origin.
        start = slope * (first - shade.frame[0, 2]) / square
        end = start + slope * span / square
        return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)
    return radial_of_frame(shade.frame, span, stops)


def _fills(colours: np.ndarray) -> list[Rgba]:
    """Return 8-bit fills of premultiplied colours (K, 4) in levels. A clear stop gets the colour of the next one."""
    visible = np.flatnonzero(colours[:, 3] >= SEEN)
    sources = [visible[np.abs(visible - i).argmin()] if len(visible) else i for i in range(len(colours))]
    return [(*eight_bit(colours[source])[:3], eight_bit(colours[k])[3]) for k, source in enumerate(sources)]
