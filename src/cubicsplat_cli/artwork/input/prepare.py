"""A picture as the artwork style takes it in: as it was before it was enlarged, and what else has happened to it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.gradients.flattening import Flattened, flattened
from cubicsplat_cli.artwork.gradients.noisy import without_blurred_gradients
from cubicsplat_cli.artwork.input.condition import Condition, condition_of
from cubicsplat_cli.artwork.input.enlargement import before_enlargement
from cubicsplat_cli.artwork.input.linear_light import without_linear_light, without_rim
from cubicsplat_cli.artwork.input.paper import scan_of
from cubicsplat_cli.artwork.input.pens import Pens, pens_of
from cubicsplat_cli.artwork.input.restore import explained_by_blur
from cubicsplat_cli.artwork.input.subpixels import without_subpixels
from cubicsplat_cli.artwork.limits import reduced, reduction
from cubicsplat_cli.artwork.shadows.lifting import Lifted, lifted
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.arrays import with_channels


@record
class PreparedInput:
    """levels: (H, W, 4) float32 premultiplied RGBA in 0..255, what is drawn. condition: of it. scale: by which its
    drawing is enlarged to (width, height), the picture's, px. times: by which the picture itself was, 1 for not.
    scanned: whether levels are the ink on a scan's paper, made white and evenly lit; pens: what drew its lines.
    flat: levels without gradients, where they had to be found to tell the condition; lifted: without their soft
    shadow, where that was; seen: the condition that they seemed to be in with it. of_lcd: whether text was smoothed for
    an LCD's subpixels; of_light: whether edges were blended in linear light. compression: of the levels' file, of a
    JPEG that is known as such.
    """

    levels: np.ndarray
    condition: Condition
    scale: int
    times: int
    width: int
    height: int
    scanned: bool = False
    pens: Pens | None = None
    flat: Flattened | None = None
    lifted: Lifted | None = None
    seen: Condition | None = None
    of_lcd: bool = False
    of_light: bool = False
    compression: Compression | None = None

    @property
    def notes(self) -> list[str]:
        """Notes for the user, a sentence each."""
        found = [f"drawn as it was before it was made {self.times} times as large"] if self.times > 1 else []
        if self.of_lcd:
            found.append("text drawn without the colour fringes that it has for LCDs")
        if self.of_light:
            found.append("edges drawn where they are in linear light, in which they were blended")
        if self.scanned:
            found.append("drawn as ink on white paper under even light")
        if self.condition.aliased:
            found.append("drawn through the steps of its edges, which have no anti-aliasing")
        if not self.condition.clean:
            found.append(f"drawn through {self.condition.words()}")
        return found


def analysed(target: np.ndarray, compression: Compression | None = None) -> PreparedInput:
    """A picture prepared for drawing. target: (H, W, 3) or (H, W, 4) premultiplied, float32 in [0, 1];
    compression: that of its file, if it has any loss.
    """
    height, width = target.shape[:2]
    factor = reduction(height, width)
    came = as_levels(target)
    whole = without_subpixels(came)
    levels = without_linear_light(whole)
    of_light = levels is not whole
    levels = without_rim(levels, in_light=of_light)
    prepared = _taken_in(reduced(levels, factor), factor, width, height, lossy=compression is not None and factor == 1)
    if levels is came and prepared.condition.jpeg and prepared.scale == 1 and not prepared.scanned:
        prepared = replace(prepared, compression=compression)
        if compression is not None and compression.tables:
            prepared = replace(prepared, condition=replace(prepared.condition, halved=compression.halved))
    return replace(prepared, of_lcd=whole is not came, of_light=of_light)


def _taken_in(levels: np.ndarray, factor: int, width: int, height: int, *, lossy: bool) -> PreparedInput:
    """The same of levels (H, W, 4), of which the picture has so many times as many each way."""
    condition, times = condition_of(levels, lossy=lossy), 1
    scan = scan_of(levels)
    if scan is not None:
        pens = pens_of(scan.bare, scan.grain)
        condition = replace(condition, noise=scan.grain, coarse=True)
        if pens is not None:
            condition = replace(condition, blur=pens.blur)
        return PreparedInput(scan.levels, condition, factor, 1, width, height, scanned=True, pens=pens)
    if not condition.noise or condition.jpeg:  # what makes pictures larger may ring as well
        levels, times = before_enlargement(levels)
        if times > 1:
            # What was enlarged without smoothing is wanted pixel by pixel.
            condition = replace(condition_of(levels), aliased=False)
    if not condition.clean and not lossy:
        # Soft areas look like blurred edges or like ringing: damage is told by what is left without them.
        without = lifted(levels)
        if without:
            unshaded = condition_of(flattened(without.levels).levels)
            if unshaded.clean:
                return PreparedInput(
                    levels, unshaded, factor * times, times, width, height, lifted=without, seen=condition
                )
    if condition.only_blurred:
        flat = without_blurred_gradients(levels, condition.blur)
        condition = condition_of(flat.levels)
        if condition.only_blurred and explained_by_blur(flat.levels, condition):
            return PreparedInput(levels, condition, factor * times, times, width, height, flat=flat)
    if condition.blur and not explained_by_blur(levels, condition):
        condition = replace(condition, blur=0.0)
    return PreparedInput(levels, condition, factor * times, times, width, height)


def as_levels(target: np.ndarray) -> np.ndarray:
    """(H, W, 4) float32 premultiplied RGBA in levels of 0..255."""
    return np.asarray(with_channels(np.asarray(target, dtype=np.float32), 4) * np.float32(255.0))
