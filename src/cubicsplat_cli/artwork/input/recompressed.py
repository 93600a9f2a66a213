"""Reconstruct the picture before a JPEG or WebP from its restored picture and the file's quantisation.

A hypothesis is compressed just as the file was. Where its coefficients round to those of the file, nothing differs,
however much both ring. The difference is added to the hypothesis, which is divided into fills and their shares again,
as a blur is undone (van Cittert's iteration, between projections onto what drawings are). The hypothesis with the least
difference is kept. What then differs in the middle of a part that no edge is near is the colour of the part.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.flattening import Flattened
from cubicsplat_cli.artwork.input.chroma import LUMA_CHROMA, Mixture, mixture_of
from cubicsplat_cli.artwork.input.condition import OUTLIER, Condition
from cubicsplat_cli.artwork.input.restore import (
    FEWEST_INSIDE,
    INSIDE,
    THIN,
    depth_in,
    labelled,
    rounded_as_jpegs,
    seen_as,
)
from cubicsplat_cli.artwork.regions.fills import SAME
from cubicsplat_cli.artwork.regions.hairlines import with_lines
from cubicsplat_cli.artwork.regions.regions import FlatPicture
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import components

MISFIT = 3.0  # levels by which pixels are off their fills


def before_compression(
    levels: np.ndarray, flat: Flattened, even: FlatPicture, condition: Condition, compression: Compression
) -> tuple[FlatPicture, np.ndarray]:
    """Return the picture before its compression, in flat fills, and the levels (H, W, 4) that its outlines are
    fitted to, corrected by what the file lacks of it; both with placeholders for gradients.

    levels: (H, W, 4) the file's; flat: the same without gradients; even: that restored, with palette and labels.
    """
    palette, best, least = even.palette, None, np.inf
    assert palette is not None and even.labels is not None  # as every restored picture with noise has
    for space in (LUMA_CHROMA, np.eye(4)):  # in RGB, chroma counts more when fills are told apart
        labels, target, fills = even.labels, even.levels, palette @ space
        for number in range(3):
            work().at()
            seen = (target @ space).astype(np.float32)
            if number:
                labels = labelled(seen, fills, compression.rounding, len(fills), bounded=True)
                labels = with_lines(seen, fills, labels, OUTLIER * MISFIT, THIN)
            mixture = mixture_of(seen, fills, labels, MISFIT, 0.0)
            picture = mixture.painted(palette)
            left = levels - compression.again(flat.painted(picture, palette, mixture.coverage))
            target = picture.copy()
            target[..., :3] += left[..., :3]
            if (error := float((left[..., :3] ** 2).sum())) < least:
                best, least = (mixture, target), error
    assert best is not None  # as the first one is better than none
    mixture, target = best
    return _told_apart(target, mixture, palette, flat.fills, seen_as(condition, sharp=True)), target


def _told_apart(
    levels: np.ndarray, mixture: Mixture, palette: np.ndarray, placeholders: np.ndarray, space: np.ndarray
) -> FlatPicture:
    """Return the picture of a mixture of a palette (P, 4), with a fill of its own for each connected part whose middle
    has another colour in levels (H, W, 4). Pixels do not tell near colours apart, but the median of many does.

    placeholders: (G, 4) fills that stay. space: (4, 4) as of `seen_as`.
    """
    labels = mixture.labels
    parts, count = components(labels)
    depth = depth_in(labels)
    inner, middle = (np.bincount(parts[depth >= least], minlength=count) for least in (1, INSIDE))
    fill_of = np.empty(count, np.int32)
    fill_of[parts] = labels
    boxes, fills, new = ndimage.find_objects(parts + 1), list(palette), labels.copy()
    shades = [[k] for k in range(len(palette))]  # the fills that each one becomes
    stays = (palette[:, None] == placeholders).all(axis=2).any(axis=1)
    for part in np.argsort(-middle, kind="stable").tolist():
        fill, shows = int(fill_of[part]), middle[part] >= FEWEST_INSIDE
        # A smaller part has one of those that larger ones show.
        if stays[fill] or not (shows or (inner[part] and len(shades[fill]) > 1)):
            continue
        box = boxes[part]
        own = parts[box] == part
        colour = np.median(levels[box][own & (depth[box] >= (INSIDE if shows else 1))], axis=0)
        off = largest(np.abs((np.array([fills[k] for k in shades[fill]]) - colour) @ space))
        if shows and off.min() > SAME:
            shades[fill].append(len(fills))
            fills.append(rounded_as_jpegs(np.rint(colour)[None])[0])
            off = np.append(off, 0.0)
        new[box][own] = shades[fill][int(off.argmin())]
    palette = np.array(fills)
    other = np.where(mixture.other == labels, new, mixture.other)
    return FlatPicture(Mixture(new, other, mixture.share).painted(palette), palette, new)
