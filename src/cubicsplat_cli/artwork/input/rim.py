"""Pictures whose drawing begins a fraction of a pixel within their own border: along that, what lies beneath each shape
shines through with the same share, whatever the colours of both.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.input.linear_light import levels_of, light_of

# Levels: by which two pixels are one colour, by which blends are off that were rounded once for each layer.
EVEN, OFF = 1.0, 2.0
FEWEST, MOST_COLOURS = 16, 32  # px of a border that show a colour, and colours that it may have
EXPLAINED = 0.95  # of a border's pixels, those that one share explains
MOST = 0.5  # the share that is left to what is beneath: the drawing begins in the outer half of the pixels


def without_rim(levels: np.ndarray, *, in_light: bool) -> np.ndarray:
    """A picture (H, W, 4) in levels with its drawing continued to the border on all sides; the same array where it ends
    there already, or is not opaque. in_light: whether its edges were blended in linear light.
    """
    if min(levels.shape[:2]) < FEWEST or (levels[..., 3] < 255.0).any():
        return levels
    out = levels
    for turns in range(4):
        rows = np.rot90(levels, turns)[:3, :, :3].astype(np.float64)
        own = _shone_through(rows, in_light)
        if own.any():
            out = levels.copy() if out is levels else out
            np.rot90(out, turns)[0, own, :3] = rows[1, own]
    return out


def _shone_through(rows: np.ndarray, in_light: bool) -> np.ndarray:
    """(W,) bool: the pixels of the first of three rows (3, W, 3) that have one and the same share of other colours than
    the next two rows have; none where fewer than two colours show that, since one might be that of a line.
    """
    even = largest(np.abs(rows[1] - rows[2])) <= EVEN
    inner, index, counts = np.unique(np.rint(rows[1, even]), axis=0, return_inverse=True, return_counts=True)
    shown = np.flatnonzero(counts >= FEWEST)
    none = np.zeros(rows.shape[1], dtype=bool)
    if not 2 <= len(shown) <= MOST_COLOURS or 2 * even.sum() < len(even):
        return none
    index, inner, counts = index.reshape(-1), inner[shown], counts[shown]
    outer = np.array([np.median(rows[0, even][index == k], axis=0) for k in shown])
    differs = largest(np.abs(outer - inner)) > OFF
    # Of white the ground, a page, tells nothing.
    shows = differs | (inner >= 255.0).all(axis=1)
    if differs.sum() < 2 or counts.sum() < EXPLAINED * even.sum():
        return none
    if ((_explained(inner, outer, in_light) & shows) @ counts).max() < EXPLAINED * counts.sum():
        return none
    none[even] = np.isin(index, shown[differs])
    return none


def _explained(inner: np.ndarray, outer: np.ndarray, in_light: bool) -> np.ndarray:
    """(T, K) bool: whether blends of colours inner (K, 3) with what another shape shows, or the white of a page, are
    `outer` (K, 3), for each of the shares that some of these would have.
    """
    beneath = np.concatenate([inner, outer, np.full((1, 3), 255.0)])
    start, end, ends = (light_of(v) if in_light else v for v in (inner, outer, beneath))
    span = ends - start[:, None]
    square = np.maximum((span * span).sum(axis=-1), 1e-9)
    shares = (((end - start)[:, None] * span).sum(axis=-1) / square).ravel()
    shares = np.append(shares[(shares > 0.0) & (shares <= MOST)], 0.0)
    blends = start[:, None] + shares[:, None, None, None] * span
    blends = levels_of(blends) if in_light else blends
    known = largest(np.abs(blends - outer[:, None])) <= OFF
    return np.asarray(known.any(axis=-1))
