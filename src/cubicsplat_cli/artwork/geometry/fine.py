"""Primitives as rings so fine that they are true to 1e-5 of a radius, and how these change with their numbers.

All points are linear in the middle, the half sides and the radius; the template of each kind says how.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring
from cubicsplat_cli.record import record

SIXTEENTHS = 16  # of a circle, one cubic each


@record
class _Template:
    """Cubics around the origin: half (S, 4, 2), times the half sides, plus round (S, 4, 2), times the radius; lines:
    (S,) bool."""

    half: np.ndarray
    round: np.ndarray
    lines: np.ndarray


def fine_ring(shape: Outline, arcs: int = SIXTEENTHS) -> Ring:
    """A ring itself; that of a primitive, its arcs in eighths of a turn or less, true to 1e-5 of a radius. arcs: those
    of a circle or ellipse.
    """
    if isinstance(shape, Ring):
        return shape
    template, middle, half, radius, angle = _parts(shape, arcs)
    cubics = (template.half * half + template.round * radius) @ _turn(angle) + middle
    smooth = np.full(len(cubics), not (isinstance(shape, Rectangle) and shape.radius <= 0.0))
    return Ring(cubics[:, 0].copy(), cubics[:, 1:3].copy(), template.lines.copy(), smooth)


def changes(shape: Circle | Ellipse | Rectangle) -> list[np.ndarray]:
    """Derivatives of the cubics (S, 4, 2) of the fine ring by each number of a primitive, in its own order."""
    template, _, half, radius, angle = _parts(shape)
    turn, quarter = _turn(angle), _turn(0.5 * np.pi)
    across, down = template.half * [1.0, 0.0] @ turn, template.half * [0.0, 1.0] @ turn
    rounded = template.round @ turn
    east, south = (np.tile(way, (len(across), 4, 1)) for way in ((1.0, 0.0), (0.0, 1.0)))
    turned = (template.half * half + template.round * radius) @ turn @ quarter
    if isinstance(shape, Circle):
        return [east, south, rounded]
    if isinstance(shape, Ellipse):
        return [east, south, across, down, turned]
    # A side's number is its whole length, and the first two are a corner, which stays when sides grow.
    return [east, south, 0.5 * (across + east), 0.5 * (down + south), rounded, turned]


def _parts(
    shape: Circle | Ellipse | Rectangle, arcs: int = SIXTEENTHS
) -> tuple[_Template, np.ndarray, np.ndarray, float, float]:
    """Template, middle (2,), half sides (2,), radius and angle."""
    if isinstance(shape, Circle):
        return _round(False, arcs), np.array([shape.cx, shape.cy]), np.zeros(2), shape.r, 0.0
    if isinstance(shape, Ellipse):
        return _round(True, arcs), np.array([shape.cx, shape.cy]), np.array([shape.rx, shape.ry]), 0.0, shape.angle
    half = 0.5 * np.array([shape.width, shape.height])
    template = _box(shape.radius > 0.0)
    return template, np.array([shape.x, shape.y]) + half, half, shape.radius, shape.angle


def _turn(angle: float) -> np.ndarray:
    cos, sin = np.cos(angle), np.sin(angle)
    return np.array([[cos, sin], [-sin, cos]])


def arc(start: float, stop: float, count: int) -> np.ndarray:
    """(count, 4, 2) cubics of the unit circle from one angle to another, radians."""
    at = np.linspace(start, stop, count + 1)
    unit = np.stack([np.cos(at), np.sin(at)], axis=1)
    reach = 4.0 / 3.0 * np.tan((stop - start) / count / 4.0) * np.stack([-unit[:, 1], unit[:, 0]], axis=1)
    return np.stack([unit[:-1], (unit + reach)[:-1], (unit - reach)[1:], unit[1:]], axis=1)


@lru_cache(maxsize=4)
def _round(ellipse: bool, arcs: int) -> _Template:
    unit = arc(0.0, 2.0 * np.pi, arcs)
    unit[-1, 3] = unit[0, 0]
    nothing = np.zeros_like(unit)
    lines = np.zeros(len(unit), dtype=bool)
    return _Template(unit, nothing, lines) if ellipse else _Template(nothing, unit, lines)


@lru_cache(maxsize=2)
def _box(rounded: bool) -> _Template:
    """From the left end of the top side (its right one where rounded) on, clockwise as seen."""
    signs = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    thirds = np.array([0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0])[:, None]
    if not rounded:
        half = signs[:, None] * (1.0 - thirds) + np.roll(signs, -1, axis=0)[:, None] * thirds
        return _Template(half, np.zeros_like(half), np.ones(4, dtype=bool))
    halves, rounds = [], []
    for k in range(4):
        corner, following = signs[(k + 1) % 4], signs[(k + 2) % 4]
        quarter = arc((k - 1) * np.pi / 2.0, k * np.pi / 2.0, 2)
        out = np.array([np.cos(k * np.pi / 2.0), np.sin(k * np.pi / 2.0)])
        halves += [np.tile(corner, (2, 4, 1)), (corner * (1.0 - thirds) + following * thirds)[None]]
        # Where the arc ends, as seen from the corner, and where the next one begins.
        rounds += [quarter - corner, ((out - corner) * (1.0 - thirds) + (out - following) * thirds)[None]]
    lines = np.tile([False, False, True], 4)
    return _Template(np.concatenate(halves), np.concatenate(rounds), lines)
