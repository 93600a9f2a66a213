"""Divided runs joined to one outline, and outlines made regular: exactly level and upright lines."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.tracing.refine import Feet
from cubicsplat_cli.artwork.tracing.sections import Division
from cubicsplat_cli.artwork.tracing.variables import Pieces

LEVEL_ERRORS = 2.0  # standard errors a line may be off an axis to count as along it
LEAST_OFF = 0.03  # px, of one end against the other, that always count so
UNKNOWN_OFF = 0.3  # px, of a line that no points tell about
STEEPEST = 0.2  # off the axis, per px along it, at most


def joined(divisions: list[Division], cornered: bool) -> tuple[Pieces, Feet]:
    """Divisions one after the other as a closed outline, and where their points belong.

    cornered: whether each division starts at a corner.
    """
    anchors = np.concatenate([d.anchors[:-1] for d in divisions])
    lines = np.concatenate([d.lines for d in divisions])
    level = np.concatenate([d.level[:-1] for d in divisions])
    cubics = np.concatenate([d.cubics for d in divisions])
    outgoing = cubics[:, 1] - cubics[:, 0]
    incoming = np.roll(cubics[:, 2] - cubics[:, 3], 1, axis=0)
    smooth = ~(lines & np.roll(lines, 1))
    if cornered:
        smooth[np.cumsum([0] + [len(d.lines) for d in divisions[:-1]])] = False
    tied = np.arange(2 * len(anchors)).reshape(-1, 2)
    return Pieces(anchors, incoming, outgoing, lines, smooth, level & smooth, tied), _feet(divisions)


def _feet(divisions: list[Division]) -> Feet:
    count, piece, u = 0, [], []
    for d in divisions:
        sizes = np.diff(d.breaks)
        piece.append(count + np.repeat(np.arange(len(sizes)), sizes))
        u += [(np.arange(size) + 0.5) / size for size in sizes]
        count += len(sizes)
    return Feet(np.concatenate(piece), np.concatenate(u))


def at_lines(pieces: Pieces) -> np.ndarray:
    """(A,) bool: the smooth joints between a line and a cubic of a closed outline."""
    return pieces.smooth & (pieces.lines ^ np.roll(pieces.lines, 1))


def loosened(pieces: Pieces) -> Pieces:
    """The pieces with the smooth joints at lines free to bend."""
    smooth = pieces.smooth & ~at_lines(pieces)
    return replace(pieces, smooth=smooth, level=pieces.level & smooth)


def tightened(pieces: Pieces, joints: np.ndarray, widest: float) -> Pieces:
    """The pieces with those of the joints (A,) bool smooth again that bend by less than `widest` radians."""
    before = np.roll(pieces.lines, 1)
    way = pieces.anchors - np.roll(pieces.anchors, 1, axis=0)
    arrive = np.where(before[:, None], way, -pieces.incoming)
    leave = np.where(pieces.lines[:, None], np.roll(way, -1, axis=0), pieces.outgoing)
    bend = np.arctan2(arrive[:, 0] * leave[:, 1] - arrive[:, 1] * leave[:, 0], (arrive * leave).sum(1))
    return replace(pieces, smooth=pieces.smooth | (joints & (np.abs(bend) < widest)))


def with_level_lines(pieces: Pieces, weights: np.ndarray, feet: Feet) -> Pieces:
    """The same pieces if no line is level or upright within its standard errors, else with those exactly so."""
    tied, anchors = pieces.tied.copy(), pieces.anchors.copy()
    for i in np.flatnonzero(pieces.lines):
        j = pieces.ends[i]
        across = np.abs(anchors[j] - anchors[i])
        c = int(np.argmin(across))
        known = float(weights[feet.piece == i].sum())
        off = max(LEVEL_ERRORS * math.sqrt(12.0 / known), LEAST_OFF) if known > 0.0 else UNKNOWN_OFF
        if across[c] <= min(off, STEEPEST * across[1 - c]) and tied[i, c] != tied[j, c]:
            tied[tied == tied[j, c]] = tied[i, c]
            same = tied[:, c] == tied[i, c]
            anchors[same, c] = anchors[same, c].mean()
    if (tied == pieces.tied).all():
        return pieces
    numbers = np.unique(tied, return_inverse=True)[1].reshape(-1, 2)
    return replace(pieces, anchors=anchors, tied=numbers)


def as_ring(pieces: Pieces) -> Ring:
    """The ring that closed pieces make."""
    return Ring(pieces.anchors, pieces.cubics[:, 1:3].copy(), pieces.lines.copy(), pieces.smooth.copy())
