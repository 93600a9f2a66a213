"""Divided runs joined to one outline, and outlines made regular: exactly level and upright lines."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.tracing.refine import Feet
from cubicsplat_cli.artwork.tracing.variables import Pieces
from cubicsplat_cli.raster.cubics import Division

LEVEL_ERRORS = 2.0  # standard errors a line may be off an axis to count as along it
LEAST_OFF = 0.03  # px, of one end against the other, that always count so
UNKNOWN_OFF = 0.3  # px, of a line that no points tell about
STEEPEST = 0.2  # off the axis, per px along it, at most


def joined(division: Division) -> Pieces:
    """The pieces of a division of a loop as a closed outline."""
    lines = division.lines
    smooth = ~(lines & np.roll(lines, 1)) & ~division.from_corner
    outgoing, incoming = division.handles[:, 0], np.roll(division.handles[:, 1], 1, axis=0)
    tied = np.arange(2 * len(lines)).reshape(-1, 2)
    return Pieces(division.anchors, incoming, outgoing, lines, smooth, division.level & smooth, tied)


def feet_of(division: Division) -> Feet:
    """Where the points of a division belong, to begin with: evenly along its pieces."""
    sizes = division.sizes
    piece = np.repeat(np.arange(len(sizes)), sizes)
    place = np.arange(len(piece)) - np.repeat(np.cumsum(sizes) - sizes, sizes)
    return Feet(piece, (place + 0.5) / sizes[piece])


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
