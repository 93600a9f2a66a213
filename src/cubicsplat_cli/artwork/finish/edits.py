"""Rings with a piece more: cut in two, a line made a curve, a joint made a corner, a corner made round."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring


def divided(ring: Ring, piece: int, t: float) -> Ring:
    """The same curve with a piece cut in two at a parameter, joined smoothly; of a line, both parts are lines."""
    a, b = _cut(ring.cubics[piece], t)
    anchors = np.insert(ring.anchors, piece + 1, a[3], axis=0)
    controls = np.insert(ring.controls, piece + 1, b[1:3], axis=0)
    controls[piece] = a[1:3]
    lines = np.insert(ring.lines, piece + 1, ring.lines[piece])
    return Ring(anchors, controls, lines, np.insert(ring.smooth, piece + 1, not ring.lines[piece]))


def curved(ring: Ring, piece: int) -> Ring:
    """The ring with a line made a cubic, straight to begin with, that turns at its ends as it likes."""
    return Ring(ring.anchors, ring.controls, ring.lines & (np.arange(ring.pieces) != piece), ring.smooth)


def cornered(ring: Ring, anchor: int) -> Ring:
    """The ring with a smooth joint made a corner."""
    return Ring(ring.anchors, ring.controls, ring.lines, ring.smooth & (np.arange(ring.pieces) != anchor))


def rounded(ring: Ring, anchor: int, reach: float) -> Ring:
    """The ring with a corner replaced by a cubic between points `reach` px before and after it, joined smoothly."""
    before, after = (anchor - 1) % ring.pieces, anchor
    cubics = ring.cubics
    first, _ = _cut(cubics[before], 1.0 - _parameter(cubics[before][::-1], reach))
    _, second = _cut(cubics[after], _parameter(cubics[after], reach))
    corner = ring.anchors[anchor]
    anchors, controls = ring.anchors.copy(), ring.controls.copy()
    controls[before] = first[1:3]
    controls[after] = second[1:3]
    anchors[anchor] = second[0]
    bend = np.stack([first[3] + (corner - first[3]) * 0.55, second[0] + (corner - second[0]) * 0.55])
    anchors = np.insert(anchors, anchor, first[3], axis=0)
    controls = np.insert(controls, anchor, bend, axis=0)
    smooth = ring.smooth.copy()
    smooth[anchor] = True
    return Ring(anchors, controls, np.insert(ring.lines, anchor, False), np.insert(smooth, anchor, True))


def _cut(cubic: np.ndarray, t: float) -> tuple[np.ndarray, np.ndarray]:
    """The parts of a cubic (4, 2) before and after t, by de Casteljau's construction."""
    rows = [cubic]
    while len(rows[-1]) > 1:
        rows.append(rows[-1][:-1] * (1.0 - t) + rows[-1][1:] * t)
    return np.stack([row[0] for row in rows]), np.stack([row[-1] for row in rows[::-1]])


def _parameter(cubic: np.ndarray, reach: float) -> float:
    """The parameter at which a cubic is about `reach` px from its start, at most two fifths."""
    length = float(np.hypot(*np.diff(cubic, axis=0).T).sum())
    return min(reach / max(length, 1e-9), 0.4)
