"""Estimate what happened to a picture since it was drawn, undo what can be undone, and note the rest.

The estimates follow the way of a picture backwards: the offsets of an LCD's subpixels, the space in which edges were
blended, the border, paper and pens, noise and compression, the scale, and the blur.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.flattening import Flattened, flattened
from cubicsplat_cli.artwork.gradients.noisy import without_blurred_gradients
from cubicsplat_cli.artwork.input.condition import (
    LEAST_BLUR_OF_JPEG,
    Condition,
    blurred_everywhere,
    condition_of,
    rounding_noise,
)
from cubicsplat_cli.artwork.input.dither import without_dither
from cubicsplat_cli.artwork.input.enlargement import before_enlargement
from cubicsplat_cli.artwork.input.linear_light import without_linear_light
from cubicsplat_cli.artwork.input.paper import WHITE, scan_of
from cubicsplat_cli.artwork.input.pens import Pens, pens_of
from cubicsplat_cli.artwork.input.restore import explained_by_blur
from cubicsplat_cli.artwork.input.sharpening import unsharp_mask, without_halos
from cubicsplat_cli.artwork.input.subpixels import without_subpixels
from cubicsplat_cli.artwork.limits import reduced, reduction
from cubicsplat_cli.artwork.regions.regions import ShadowSides
from cubicsplat_cli.artwork.regions.sampling import error_of_steps
from cubicsplat_cli.artwork.shadows.lifting import Lifted, lifted
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels

Plain = tuple[np.ndarray, list[str]]  # a picture (H, W, 4) in levels, and notes
HALOS = "drawn without the halos that sharpening left at its edges"


@record
class PreparedInput:
    """levels: (H, W, 4) float32 premultiplied RGBA in 0..255, the picture to draw, in a condition. scale: the factors
    across and down by which its drawing is enlarged to the canvas of (width, height) px. upscale_factor: the mean
    factor by which the picture had been enlarged, 1 for none. scanned: True if levels are ink on a scan's paper, made
    even; pens: the pens of its lines. flat: levels without gradients, if the condition was estimated from these.
    lifted: levels without their soft shadow, if the condition was estimated from these. compression: that of the
    levels' file, if it has any loss. shaded: the sides of the shadows that levels lack. edge_notes: notes on how edges
    had been blended.
    """

    levels: np.ndarray
    condition: Condition
    scale: tuple[float, float]
    upscale_factor: float
    width: int
    height: int
    scanned: bool = False
    pens: Pens | None = None
    flat: Flattened | None = None
    lifted: Lifted | None = None
    compression: Compression | None = None
    shaded: Sequence[ShadowSides] = ()
    edge_notes: tuple[str, ...] = ()

    @property
    def mean_scale(self) -> float:
        """The geometric mean of the factors across and down."""
        return math.sqrt(self.scale[0] * self.scale[1])

    @property
    def unavoidable_error(self) -> float:
        """Levels rms by which a drawing that lost nothing is off: by noise, or steps of edges without anti-aliasing."""
        return error_of_steps(self.levels) if self.condition.aliased else self.condition.noise

    @property
    def notes(self) -> list[str]:
        """Notes for the user, a sentence each."""
        times = self.upscale_factor
        notes = [f"drawn as it was before it was made {times:.3g} times as large"] if times > 1 else []
        notes += self.edge_notes
        if self.scanned and self.condition.coarse:
            notes.append("drawn as ink on even paper, without its grain and shadows")
        if self.condition.aliased:
            notes.append("drawn through the steps of its edges, which have no anti-aliasing")
        if not self.condition.clean:
            notes.append(f"drawn through {self.condition.description}")
        return notes


def analysed(
    target: np.ndarray, compression: Compression | None = None, plain: Callable[[], Plain] | None = None
) -> PreparedInput:
    """Prepare a picture, (H, W, 3) or premultiplied (H, W, 4), float32 in [0, 1]. compression: of a file with loss.
    plain: returns the picture as of `without_filters`, where that is known."""
    height, width = target.shape[:2]
    factor, notes = reduction(height, width), list[str]()
    original = as_levels(target)
    even, noise = (original, None) if compression else without_dither(original)
    if even is not original:
        notes.append("drawn in the colours that its palette stands for")
    as_read = compression is None and noise is None
    if as_read and (rounding := rounding_noise(original)) and without_linear_light(original) is original:
        # Blends in linear light look rounded too, and rounded ones look sharpened.
        condition = Condition(rounding, rounded=True)
        prepared = _prepared(reduced(even, factor), condition, factor, width, height, known=True)
        return replace(prepared, edge_notes=tuple(notes))
    known = plain() if plain and even is original else None
    unsharp, filter_notes = known or without_filters(even, lossy=compression is not None)
    notes += filter_notes
    unsharp = unsharp if filter_notes else even
    levels = without_linear_light(unsharp)
    if levels is not unsharp:
        notes.append("edges drawn where they are in linear light, in which they were blended")
    levels, lossy = reduced(levels, factor), compression is not None and factor == 1
    # Means in place of dither look like compression.
    seen = levels if noise is None else reduced(original, factor)
    condition = Condition(noise) if noise else condition_of(seen, lossy=lossy)
    prepared = _prepared(levels, condition, factor, width, height, known=lossy)
    condition = replace(prepared.condition, sharpened=HALOS in notes)
    as_drawn = levels is original and prepared.mean_scale == 1 and not prepared.scanned
    compression = compression if condition.jpeg and as_drawn else None
    if compression and compression.tables:
        condition = replace(condition, halved=compression.halved)
    return replace(prepared, condition=condition, compression=compression, edge_notes=tuple(notes))


def without_filters(levels: np.ndarray, *, lossy: bool) -> Plain:
    """Return a picture (H, W, 4) in levels without what programs do to a finished one, and notes on that: colour
    fringes of text, and sharpening; the same array if nothing was done. lossy: True if its file was compressed with
    loss, whose ringing looks like sharpening.
    """
    plain = without_subpixels(levels)
    notes = [] if plain is levels else ["text drawn without the colour fringes that it has for LCDs"]
    mask = unsharp_mask(plain, lossy=lossy)
    found = mask.undone(plain) if mask else plain
    if not lossy:
        found = without_halos(found)
    # Kernels of enlarging ring as sharpening does.
    if found is plain or max(before_enlargement(plain)[1]) > 1:
        return plain, notes
    return found, [*notes, HALOS]


def _prepared(
    levels: np.ndarray, condition: Condition, factor: int, width: int, height: int, *, known: bool
) -> PreparedInput:
    """Prepare levels (H, W, 4) in a condition, whose edges are blended as sRGB values. factor: that by which the
    picture, of (width, height) px, was reduced to these; known: True if the damage is no mere estimate.
    """
    if scan := scan_of(levels):
        pens = scan.pens or pens_of(scan.bare, WHITE, scan.grain)
        if pens is not None:
            condition = replace(condition, blur=pens.blur)
        if scan.grain:
            condition = replace(condition, noise=scan.grain, coarse=True)
        return PreparedInput(scan.levels, condition, (factor, factor), 1.0, width, height, scanned=True, pens=pens)
    across, down = 1.0, 1.0
    if not condition.noise or condition.jpeg:  # kernels of enlarging ring as JPEGs do
        small, factors = before_enlargement(levels)
        if max(factors) > 1:
            # The steps of a picture that was enlarged without smoothing are its pixels, and are drawn.
            before = replace(condition_of(small), aliased=False)
            # Through a wide blur a picture looks enlarged, but may be too small then to tell the blur. Linear
            # interpolation blurs by half a px of the small one, measured to a sixth: no more than a JPEG.
            if before.blur or condition.blur <= LEAST_BLUR_OF_JPEG * math.sqrt(math.prod(factors)):
                levels, (across, down), condition = small, factors, before
    scale = factor * across, factor * down
    prepared = PreparedInput(levels, condition, scale, math.sqrt(across * down), width, height)
    # Soft areas look like blurred edges or like ringing, so damage is estimated without them, unless it is everywhere.
    everywhere = condition.coarse or (condition.only_blurred and blurred_everywhere(levels))
    if not (condition.clean or known or everywhere) and (without := lifted(levels)):
        unshaded = condition_of(flattened(without.levels).levels)
        if unshaded.clean:
            return replace(prepared, condition=unshaded, lifted=without)
    if condition.only_blurred:
        flat = without_blurred_gradients(levels, condition.blur)
        condition = condition_of(flat.levels)
        if condition.only_blurred and explained_by_blur(flat.levels, condition):
            return replace(prepared, condition=condition, flat=flat)
    if condition.blur and not explained_by_blur(levels, condition):
        condition = replace(condition, blur=0.0)
    return replace(prepared, condition=condition)


def as_levels(target: np.ndarray) -> np.ndarray:
    """Return (H, W, 4) float32 premultiplied RGBA in levels of 0..255, of a picture in [0, 1] (H, W, 3 or 4)."""
    return with_channels(np.asarray(target, dtype=np.float32), 4) * np.float32(255.0)
