"""Outlines divided into lines and cubics and fitted to points, and feet of points on cubics, by the native library."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import byref, c_double, c_int64
from functools import cached_property, partial
from typing import Any, NamedTuple

import numpy as np

from cubicsplat_cli.raster.native import Out, bools, doubles, int64s, native
from cubicsplat_cli.raster.sparse import SparseRows
from cubicsplat_cli.record import record

_native = partial(native, "outlines")
# An outline of A anchors: these, and the handles before and after them, relative to them, (A, 2) px each.
Outline = tuple[np.ndarray, np.ndarray, np.ndarray]
ROUNDS = 8  # of a fit


def newton_steps(cubics: np.ndarray, points: np.ndarray, u: np.ndarray) -> np.ndarray:
    """Return the parameters u (P, K) after one Newton step towards the feet of points (P, K, 2) on cubics (P, 4, 2)."""
    return _native("cs_nearer", *u.shape, doubles(cubics), doubles(points), doubles(u), Out(u.shape), result=None)


@record
class Division:
    """S lines and cubics in a row. sizes: (S,) the number of points of each. anchors: (S, 2) px, the starts. handles:
    (S, 2, 2) px, the control points after the start and before the end, relative to these. lines: (S,) bool. level:
    (S,) bool, pieces that start exactly along an axis. from_corner: (S,) bool, pieces that start at a corner."""

    sizes: np.ndarray
    anchors: np.ndarray
    handles: np.ndarray
    lines: np.ndarray
    level: np.ndarray
    from_corner: np.ndarray

    @staticmethod
    def room(count: int) -> list[Out]:
        """Return arrays for the fields of at most so many pieces."""
        return [Out(count, np.int64), Out((count, 2)), Out((count, 2, 2)), *(Out(count, bool) for _ in range(3))]


def divided_run(
    fits: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    weights: np.ndarray,
    ends: tuple[np.ndarray, np.ndarray, np.ndarray],
    price: float,
) -> tuple[Division, float]:
    """Return the cheapest division of a run of m points between two corners into lines and cubics, and its cost in
    nats: half of Huber's chi^2 plus the price of a parameter times their number.

    fits: of the points, positions (m, 2) px, unit tangents (m, 2), curvatures (m,) 1/px, and standard errors (m, 2), px
    across the run and radians. weights: (m,) 1/px^2, 0 for points that say nothing. ends: positions, unit tangents and
    standard errors, (2, 2) each, of the start and the end of the run. price: nats.
    """
    count, cost = len(weights), c_double()
    given = [doubles(array) for array in (*fits, weights, *ends)]
    out = *Division.room(count + 2), byref(cost)
    return Division(*_native("cs_divide", count, *given, float(price), *out, result=c_int64)), cost.value


def found_merges(
    ring: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, np.ndarray],
    samples: tuple[np.ndarray, np.ndarray, np.ndarray],
    judged: tuple[float, float, float],
    runs: tuple[int, int, int],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Find the runs of pieces of a ring that a line, or else a cubic, may replace. Return numbers (m, 4): the first
    piece, their number, 1 for a line, and the parameters saved; the control points (m, 4, 2) of the replacement; and
    the nats (m,), above 0, that it is expected to save.

    ring: the pieces (S, 4, 2), and four (S,) bool: lines; pieces that start smoothly; pieces that start at a place that
    stays; and pieces that show. samples: points along it (n, 2) px, weights (n,), and the end of each piece's points
    (S,). judged: nats a parameter, the share of half of chi^2 that counts against a run, and the least cosine between
    the directions at its ends. runs: the longest run that shows, and that does not; the fewest pieces of a ring.
    """
    (pieces, *flags), (points, weights, ends) = ring, samples
    most = len(pieces) * runs[1]
    shape = len(pieces), doubles(pieces), *map(bools, flags)
    given = int64s(ends), doubles(points), doubles(weights), *judged, int64s(runs)
    out = Out((most, 4), np.int64), Out(most), Out((most, 4, 2))
    numbers, nets, cubics = _native("cs_find_merges", *shape, *given, *out, result=c_int64)
    return numbers, cubics, nets


@record
class Joints:
    """The constraints that an outline of A anchors and S pieces (A when closed, else A - 1) keeps while it is fitted.
    lines: (S,) bool. smooth: (A,) bool, joints across which feet pass, and at which handles lie in line. level: (A,)
    bool, smooth joints whose direction stays. tied: (A, 2) int, the variable of each coordinate of an anchor, or -1."""

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
        return _native("cs_count_variables", *self._given, result=c_int64)

    @cached_property
    def numbers(self) -> JointNumbers:
        """The variables of the joints."""
        return JointNumbers(*_native("cs_number_joints", *self._given, Out((len(self.smooth), 5), np.int64)).T)


class JointNumbers(NamedTuple):
    """The numbers of the variables of joints, (A,) each, -1 for none: the angle and the lengths of the handles of
    smooth joints; and the first of the two variables of a handle at a corner."""

    angle: np.ndarray
    length_in: np.ndarray
    length_out: np.ndarray
    vector_in: np.ndarray
    vector_out: np.ndarray


def tied_coordinates(anchors: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Return (A, 2) int64: the variable of each anchor's coordinate, one for both ends of level and upright lines."""
    return _native("cs_tie", len(anchors), len(lines), doubles(anchors), bools(lines), Out(anchors.shape, np.int64))


def held_ring(
    anchors: np.ndarray, controls: np.ndarray, lines: np.ndarray, smooth: np.ndarray, size: tuple[int, int],
    on_border: float, pins: tuple[Sequence[float], Sequence[float]],
) -> Pieces:  # fmt: skip
    """Return a ring of anchors (A, 2), px, and control points (A, 2, 2) with the held coordinates in place; joints with
    handles out of line become corners.

    size: px of the canvas; anchors within `on_border` px of its border are moved onto it. pins: x, and y, that stay.
    """
    outline = _copies((anchors, np.empty(anchors.shape), np.empty(anchors.shape)))
    joints = Joints(lines, np.array(smooth, bool), np.empty(len(smooth), bool), np.empty(anchors.shape, np.int64))
    held = *size, float(on_border), len(pins[0]), len(pins[1]), doubles([*pins[0], *pins[1]])
    given = len(anchors), doubles(controls), bools(lines), *held
    _native("cs_hold_ring", *given, *outline, joints.smooth, joints.level, joints.tied)
    return Pieces(outline, joints)


@record
class Pieces:
    """An outline of A anchors and S pieces that is fitted, and the joints that it keeps. Its variables move anchors,
    directions of smooth joints and the lengths of handles there, and handles at corners."""

    outline: Outline
    joints: Joints

    @property
    def anchors(self) -> np.ndarray:
        """(A, 2) px."""
        return self.outline[0]

    @property
    def lines(self) -> np.ndarray:
        """(S,) bool."""
        return self.joints.lines

    @cached_property
    def cubics(self) -> np.ndarray:
        """(S, 4, 2) control points, not to be written to; those of a line lie at its thirds."""
        given = len(self.anchors), len(self.lines), bools(self.lines), *map(doubles, self.outline)
        return _read_only(_native("cs_outline_cubics", *given, Out((len(self.lines), 4, 2)), result=None))

    @cached_property
    def jacobian(self) -> SparseRows:
        """(8 S, variables): how the coordinates of each piece's control points move with the variables."""
        rows = 8 * len(self.lines)
        starts, out = np.empty(rows + 1, np.int32), (Out(8 * rows, np.int32), Out(8 * rows))
        given = *self.joints._given, *map(doubles, self.outline), starts
        columns, values = _native("cs_outline_jacobian", *given, *out, result=c_int64)
        return SparseRows(starts, columns, values, self.joints.variables)

    def moved(self, step: np.ndarray) -> Pieces:
        """Return the pieces after a step (at least `variables` numbers), of at most 3 px or half a radian each."""
        found = Pieces(_copies(self.outline), self.joints)
        given = *self.joints._given, doubles(step), *found.outline
        vars(found)["cubics"] = _read_only(_native("cs_move_outline", *given, Out((len(self.lines), 4, 2))))
        return found

    def refined(
        self, points: np.ndarray, weights: np.ndarray, feet: tuple[np.ndarray, np.ndarray], rounds: int = ROUNDS
    ) -> tuple[Pieces, tuple[np.ndarray, np.ndarray], float]:
        """Fit the outline to points (n, 2) along its normals by at most `rounds` damped Gauss-Newton steps. Return it,
        the feet of the points, and chi^2: Huber's, of distances in standard errors, linear beyond 3.

        The handles at smooth joints are turned into one direction first. weights: (n,) 1/px^2. feet: piece (n,) and
        parameter (n,) to start from.
        """
        parts, piece, u = _copies(self.outline), np.array(feet[0], np.int64), np.array(feet[1], np.float64)
        places = len(u), doubles(points), doubles(weights), piece, u
        chi = _native("cs_refine", *self.joints._given, *parts, *places, rounds, result=c_double)
        return Pieces(parts, self.joints), (piece, u), chi


def _read_only(cubics: np.ndarray) -> np.ndarray:
    cubics.flags.writeable = False
    return cubics


def _copies(outline: Outline) -> Outline:
    anchors, incoming, outgoing = (np.array(part, np.float64, order="C") for part in outline)
    return anchors, incoming, outgoing
