"""Segments of many curves at once, of one length or of several, and the rings that they are joined to."""

from __future__ import annotations

from cubicsplat_cli.record import record
from cubicsplat_cli.scene import segments_from_points
from cubicsplat_cli.scene.arrays import Array, namespace
from cubicsplat_cli.settings import Mode


@record
class SegmentIndices:
    """Of each segment, (N, M) or, where curves do not differ, (1, M): its number, and those of the ones before and
    after it, round its ring if it is closed, else from 0 to the number of segments; and, (N, M), whether it is one, and
    not room that a shorter curve leaves.
    """

    index: Array
    before: Array
    after: Array
    real: Array


def segments_of(points: Array, mode: Mode, ring_ends: Array | None) -> SegmentIndices:
    xp, count, device = namespace(points), segments_from_points(mode, points.shape[1]), points.device
    if ring_ends is None:
        ends = xp.full((1, 1), count, dtype=xp.int64, device=device)
    else:
        ends = xp.astype(ring_ends, xp.int64)
    index = xp.broadcast_to(xp.arange(count, device=device), (len(ends), count))
    before, after = xp.clip(index - 1, min=0), index + 1
    if mode is Mode.CLOSED:
        ring = xp.clip(
            xp.sum(xp.astype(index[:, :, None] >= ends[:, None, :], xp.int64), axis=-1), max=ends.shape[1] - 1
        )
        start = xp.take_along_axis(xp.concat((xp.zeros_like(ends[:, :1]), ends), axis=1), ring, axis=1)
        end = xp.take_along_axis(ends, ring, axis=1)
        before, after = xp.where(index == start, end - 1, before), xp.where(after >= end, start, after)
    return SegmentIndices(index, before, after, xp.broadcast_to(index < ends[:, -1:], (len(points), count)))


def interleaved(starts: Array, seconds: Array, thirds: Array, end: Array, mode: Mode) -> Array:
    """(N, K, 2) from what each segment's first three points have, (N, M, 2), and a stroke's last one, (N, 1, 2)."""
    xp, (n, m, _) = namespace(starts), starts.shape
    found = xp.reshape(xp.stack((starts, seconds, thirds), axis=2), (n, 3 * m, 2))
    return found if mode is Mode.CLOSED else xp.concat((found, end), axis=1)


def points_of_segments(values: Array, index: Array) -> Array:
    """Of (N, K, 2) those at (N or 1, M) places of each curve: (N, M, 2)."""
    return namespace(values).take_along_axis(values, index[..., None], axis=1)


def lengths(u: Array) -> Array:
    xp = namespace(u)
    return xp.sqrt(xp.sum(u * u, axis=-1))


def cross(u: Array, v: Array) -> Array:
    return u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0]
