"""The axes about which rings are their own mirror images; what agrees about one within its errors shares it."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.finish.merges import Visibility
from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.regularities.alike import FARTHEST, MEAN, SIGMAS, SYSTEMATIC, Symmetry, Track, symmetry_of
from cubicsplat_cli.artwork.regularities.mirrored import Axis

LEVEL = 1e-9


def found_axes(rings: dict[int, tuple[Ring, Visibility]], size: tuple[int, int]) -> dict[int, Axis]:
    """Of rings by number the axes of those that are their own mirror images, on half steps of the file's grid; size:
    px of the canvas."""
    found: dict[int, Symmetry] = {}
    for k, (ring, visibility) in rings.items():
        if is_box(ring):
            continue
        track = Track.of(ring, visibility)
        symmetries = [s for across in (0, 1) if (s := symmetry_of(track, across)) is not None]
        good = [s for s in symmetries if s.most < FARTHEST and s.mean < MEAN]
        if good:
            found[k] = min(good, key=lambda s: s.mean)
    half_step = 0.5 * 10.0 ** -suggested_precision(*size)
    axes: dict[int, Axis] = {}
    for across in (0, 1):
        own = {k: s for k, s in found.items() if s.axis.across == across}
        axes |= {
            k: Axis(across, half_step * round(at / half_step)) for k, at in _shared(own, 0.5 * size[across]).items()
        }
    return axes


def is_box(ring: Ring) -> bool:
    """Whether a ring has nothing but level and upright lines that a box has too, which are mirror images anyway."""
    steps = np.abs(np.roll(ring.anchors, -1, axis=0) - ring.anchors)
    return ring.pieces <= 4 and bool(ring.lines.all() and (steps < LEVEL).any(axis=1).all())


def _shared(found: dict[int, Symmetry], middle: float) -> dict[int, float]:
    """Places of the axes: the middle of the canvas, or the mean of those that are one, the surest first."""
    places: dict[int, float] = {}
    rest = sorted(found, key=lambda k: (found[k].error, k))
    places |= {k: middle for k in rest if _within(found[k], middle)}
    rest = [k for k in rest if k not in places]
    while rest:
        first = found[rest[0]].axis.at
        own = [k for k in rest if _within(found[k], first)]
        weights = [found[k].error ** -2 for k in own]
        places |= dict.fromkeys(own, float(np.average([found[k].axis.at for k in own], weights=weights)))
        rest = [k for k in rest if k not in places]
    return places


def _within(symmetry: Symmetry, at: float) -> bool:
    return abs(symmetry.axis.at - at) <= SIGMAS * float(np.hypot(symmetry.error, SYSTEMATIC))
