"""Outlines divided into lines and cubics and fitted to points, and feet of points on cubics, by the native library.

All raise EngineError where the library or the memory is missing.
"""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref, c_double, c_int64
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from cubicsplat_cli.raster.cpu import bools, doubles, int64s, native
from cubicsplat_cli.record import record

_native = partial(native, "outlines")
Outline = tuple[np.ndarray, np.ndarray, np.ndarray]


def newton_steps(cubics: np.ndarray, points: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The parameters u (P, K) after one Newton step towards the feet of points (P, K, 2) on cubics (P, 4, 2)."""
    u = doubles(u)
    out = np.empty_like(u)
    _native("cs_nearer", *u.shape, doubles(cubics), doubles(points), u, out, result=None)
    return out


@record
class Division:
    """S lines and cubics in a row. sizes: (S,) how many points belong to each. anchors: (S, 2) px, where each starts.
    handles: (S, 2, 2) px, of each its control points after its start and before its end, relative to these. lines: (S,)
    bool. level: (S,) bool, whether the direction where a piece starts is exactly along an axis. from_corner: (S,) bool,
    whether a piece starts at a corner."""

    sizes: np.ndarray
    anchors: np.ndarray
    handles: np.ndarray
    lines: np.ndarray
    level: np.ndarray
    from_corner: np.ndarray

    @classmethod
    def _room(cls, count: int) -> Division:
        flags = (np.empty(count, dtype=bool) for _ in range(3))
        return cls(np.empty(count, np.int64), np.empty((count, 2)), np.empty((count, 2, 2)), *flags)

    def _first(self, count: int) -> Division:
        return Division(*(array[:count].copy() for array in vars(self).values()))


def divided_run(
    fits: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    weights: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray, np.ndarray],
    price: float,
) -> tuple[Division, float]:
    """The cheapest division of a run of m points between two corners into lines and cubics, and its cost in nats: half
    of Huber's chi^2 plus the price of a parameter times their number.

    fits: of the points, positions (m, 2) px, unit tangents (m, 2), curvatures (m,) 1/px, and standard errors (m, 2), px
    across the run and radians. weights: (m,) 1/px^2, 0 where points tell nothing. ends: positions, unit tangents and
    standard errors, (2, 2) each, where the run starts and stops. price: nats.
    """
    count, cost = len(weights), c_double()
    given = [doubles(array) for array in (*fits, weights, *ends)]
    found = Division._room(count + 2)
    out = *vars(found).values(), byref(cost)
    pieces = _native("cs_divide", count, *given, float(price), *out, result=c_int64)
    return found._first(pieces), cost.value


def found_merges(
    ring: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    samples: tuple[np.ndarray, np.ndarray, np.ndarray],
    judged: tuple[float, float, float],
    runs: tuple[int, int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The runs of pieces of a ring for which a line, or else a cubic, may stand: numbers (m, 4), the first piece, how
    many there are, whether it is a line, and the parameters saved; its control points (m, 4, 2); and the nats (m,)
    expected to be saved, which are more than none.

    ring: the pieces (S, 4, 2), and (S,) bool whether each is a line, starts smoothly, starts at a place that stays, and
    shows. samples: points along it (n, 2) px, weights (n,), and where those of each piece end (S,). judged: nats a
    parameter, the share of half of chi^2 that counts against a run, and the least cosine of the angle between the
    directions at its ends. runs: the longest where it shows, and where it does not; the fewest pieces of a ring.
    """
    pieces, most = len(ring[0]), len(ring[0]) * runs[1]
    numbers, cubics, nets = np.empty((most, 4), np.int64), np.empty((most, 4, 2)), np.empty(most)
    flags = [bools(each) for each in ring[1:]]
    points, weights, ends = samples
    given = int64s(ends), doubles(points), doubles(weights), *judged, np.array(runs, np.int64)
    count = _native("cs_find_merges", pieces, doubles(ring[0]), *flags, *given, numbers, nets, cubics, result=c_int64)
    return numbers[:count], cubics[:count], nets[:count]


@record
class Joints:
    """The constraints that an outline of A anchors and S pieces (A when closed, else A - 1) keeps while it is fitted.
    lines: (S,) bool. smooth: (A,) bool, whether feet pass from piece to piece there, and handles lie in line. level:
    (A,) bool, smooth ones whose direction stays. tied: (A, 2) int, the variable of each coordinate of an anchor, -1 for
    none."""

    lines: np.ndarray
    smooth: np.ndarray
    level: np.ndarray
    tied: np.ndarray

    @cached_property
    def _given(self) -> list[Any]:
        flags = [bools(array) for array in (self.lines, self.smooth, self.level)]
        return [len(self.smooth), len(self.lines), *flags, int64s(self.tied)]

    @cached_property
    def variables(self) -> int:
        """The number of variables that move the outline."""
        return int(_native("cs_count_variables", *self._given, result=c_int64))

    @cached_property
    def numbers(self) -> JointNumbers:
        """The variables of the joints."""
        out = np.empty((len(self.smooth), 5), np.int64)
        _native("cs_number_joints", *self._given, out)
        return JointNumbers(*out.T)


class JointNumbers(NamedTuple):
    """The variables of joints by number, (A,) each, -1 for none: the angle and the lengths of the handles of smooth
    ones; and the first of two, of a handle at a corner."""

    angle: np.ndarray
    length_in: np.ndarray
    length_out: np.ndarray
    vector_in: np.ndarray
    vector_out: np.ndarray


def tied_coordinates(anchors: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """(A, 2) int64 the variable of each coordinate of anchors (A, 2): one for both ends of a piece that is a level or
    upright line; lines: (S,) bool.
    """
    tied = np.empty(anchors.shape, np.int64)
    _native("cs_tie", len(anchors), len(lines), doubles(anchors), bools(lines), tied)
    return tied


def held_ring(
    anchors: np.ndarray,
    controls: np.ndarray,
    lines: np.ndarray,
    smooth: np.ndarray,
    size: tuple[int, int],
    on_border: float,
    pins: tuple[Sequence[float], Sequence[float]],
) -> tuple[Outline, Joints]:
    """A ring of anchors (A, 2), px, and control points (A, 2, 2) with what is held in place, and its joints: those that
    are no smooth ones by their handles are corners.

    size: px of the canvas, on whose border what lies nearer to it than `on_border` px is brought; pins: the x, and the
    y, that stay.
    """
    outline = np.array(anchors, np.float64, order="C"), np.empty(anchors.shape), np.empty(anchors.shape)
    joints = Joints(lines, np.array(smooth, bool), np.empty(len(smooth), bool), np.empty(anchors.shape, np.int64))
    held = *size, float(on_border), len(pins[0]), len(pins[1]), doubles([*pins[0], *pins[1]])
    given = len(anchors), doubles(controls), bools(lines), *held
    _native("cs_hold_ring", *given, *outline, joints.smooth, joints.level, joints.tied)
    return outline, joints


def outline_directions(joints: Joints, outline: Outline) -> np.ndarray:
    """(A, 2) unit tangents of the smooth joints. outline: as for `moved_outline`."""
    out = np.empty(outline[0].shape)
    _native("cs_directions", *joints._given, *map(doubles, outline), out)
    return out


def moved_outline(joints: Joints, outline: Outline, step: np.ndarray) -> tuple[Outline, np.ndarray]:
    """An outline after a step of its variables (at least as many numbers), of at most 3 px or half a radian each, and
    its control points, as `outline_cubics` gives them.

    outline: anchors, and handles before and after them, relative to them, (A, 2) px each.
    """
    parts = [np.array(part, dtype=np.float64, order="C") for part in outline]
    cubics = np.empty((len(joints.lines), 4, 2))
    _native("cs_move_outline", *joints._given, doubles(step), *parts, cubics)
    return (parts[0], parts[1], parts[2]), cubics


def outline_cubics(lines: np.ndarray, outline: Outline) -> np.ndarray:
    """(S, 4, 2) the control points of an outline of S pieces, some of them lines (S,) bool, whose control points lie at
    their thirds. outline: as for `moved_outline`.
    """
    out = np.empty((len(lines), 4, 2))
    flags = bools(lines)
    _native("cs_outline_cubics", len(outline[0]), len(lines), flags, *map(doubles, outline), out, result=None)
    return out


def outline_jacobian(joints: Joints, outline: Outline) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The Jacobian of the 8 coordinates of each piece's control points by the variables: the values, columns and row
    starts of a sparse matrix. outline: as for `moved_outline`.
    """
    rows = 8 * len(joints.lines)
    values, columns, starts = np.empty(8 * rows), np.empty(8 * rows, np.int32), np.empty(rows + 1, np.int32)
    given = *joints._given, *map(doubles, outline)
    count = _native("cs_outline_jacobian", *given, starts, columns, values, result=c_int64)
    return values[:count].copy(), columns[:count].copy(), starts


def refined(
    joints: Joints,
    outline: Outline,
    points: np.ndarray,
    weights: np.ndarray,
    feet: tuple[np.ndarray, np.ndarray],
    rounds: int,
) -> tuple[Outline, tuple[np.ndarray, np.ndarray], float]:
    """An outline nearest to points (n, 2) along its normals, by at most `rounds` damped Gauss-Newton steps, their feet,
    and chi^2: Huber's, of distances in standard errors, linear beyond 3.

    outline: anchors, and handles before and after them, relative to them, (A, 2) px each; those at smooth joints are
    turned into one direction first. weights: (n,) 1/px^2. feet: piece (n,) and parameter (n,) to start from.
    """
    parts = tuple(np.array(part, dtype=np.float64, order="C") for part in outline)
    piece, u = np.array(feet[0], dtype=np.int64), np.array(feet[1], dtype=np.float64)
    places = len(u), doubles(points), doubles(weights), piece, u
    chi = _native("cs_refine", *joints._given, *parts, *places, rounds, result=c_double)
    return (parts[0], parts[1], parts[2]), (piece, u), float(chi)
