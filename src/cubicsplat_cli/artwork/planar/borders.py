"""The borders between visible regions, as runs along the drawing's own lines and cubics that meet at nodes; and as
edges in whole steps of a file's grid, each of them there once, whichever regions it bounds.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import EXACT, cubic_parts, derivatives, points_at
from cubicsplat_cli.artwork.geometry.rows import Link, pairs_of, rows_of
from cubicsplat_cli.artwork.geometry.stroke import line_chain
from cubicsplat_cli.artwork.planar.faces import LEAST_WIDTH, Faces
from cubicsplat_cli.artwork.planar.snapping import GRID, Sources
from cubicsplat_cli.raster.cubics import ROUNDS, newton_steps
from cubicsplat_cli.record import record

ASTRAY = 0.25  # px that a node may lie off the vertex of the map
Step = tuple[int, bool]  # the number of an edge or a run, and whether along it
Cycles = dict[int, list[list[Step]]]  # of each region its closed borders, each a list of runs


@dataclass(eq=False)
class Run:
    """A part of one piece between two vertices. edges: in order; t: parameters at its ends; loop: the number of the
    closed border without nodes that it is of, or -1."""

    piece: int
    t: tuple[float, float]
    edges: list[Step]
    loop: int


@record
class Borders:
    """runs: all of them. ends: (runs, 2) the vertices at which they begin and end. cycles: with the region on the left
    of each, y upwards."""

    runs: list[Run]
    ends: np.ndarray
    cycles: Cycles

    def place(self, end: Link) -> tuple[int, float]:
        """Return the piece on which an end of a run (run, 0 or 1) lies, and the parameter there."""
        run = self.runs[end[0]]
        return run.piece, run.t[end[1]]


def borders_of(faces: Faces, region: np.ndarray, sources: Sources) -> Borders:
    """The borders between the regions (F,) of a planar map."""
    kept = region[faces.face[0::2]] != region[faces.face[1::2]]
    runs: list[Run] = []
    for number, (chain, closed) in enumerate(_chains(faces, kept)):
        runs += _along_pieces(chain, faces, sources, number if closed else -1)
    ends = np.array([_ends(run, faces) for run in runs], dtype=np.int64).reshape(-1, 2)
    return Borders(runs, ends, _cycles(faces, region, kept, runs))


def _ends(run: Run, faces: Faces) -> tuple[int, int]:
    (first, ahead), (last, onward) = run.edges[0], run.edges[-1]
    return int(faces.ends[first, int(not ahead)]), int(faces.ends[last, int(onward)])


def _chains(faces: Faces, kept: np.ndarray) -> list[tuple[list[Link], bool]]:
    """Return the kept edges in rows from node to node, and in closed rows without nodes (True)."""
    edges = np.flatnonzero(kept).tolist()
    meetings: dict[int, list[Link]] = defaultdict(list)
    for e in edges:
        for end in (0, 1):
            meetings[int(faces.ends[e, end])].append((e, end))
    return rows_of(edges, pairs_of(meetings.values()))


def _along_pieces(chain: list[Link], faces: Faces, sources: Sources, loop: int) -> list[Run]:
    """The runs of a chain: it keeps to a piece as long as that goes on, then takes the one that follows it. loop: as of
    the runs.
    """
    runs: list[Run] = []
    after = sources.after
    for e, entered in chain:
        ahead = entered == 0
        found = [(p, (a, b) if ahead else (b, a)) for p, a, b in faces.runs[e]]
        last = runs[-1] if runs else None
        same = next((t for p, t in found if last and p == last.piece and _goes_on(last.t, t)), None)
        if last is not None and same is not None:
            last.t = (last.t[0], same[1])
            last.edges.append((e, ahead))
            continue
        joined = ((p, t) for p, t in found if last and (after[last.piece] == p or after[p] == last.piece))
        runs.append(Run(*next(joined, found[0]), [(e, ahead)], loop))
    if loop >= 0 and len(runs) > 1 and runs[0].piece == runs[-1].piece and _goes_on(runs[-1].t, runs[0].t):
        last = runs.pop()
        runs[0] = Run(last.piece, (last.t[0], runs[0].t[1]), last.edges + runs[0].edges, loop)
    return runs


def _goes_on(before: tuple[float, float], after: tuple[float, float]) -> bool:
    same_way = (before[1] > before[0]) == (after[1] > after[0])
    return same_way and abs(after[0] - before[1]) < 0.5  # else a ring of one piece begins again


def _cycles(faces: Faces, region: np.ndarray, kept: np.ndarray, runs: list[Run]) -> Cycles:
    of_half: dict[int, Step] = {}
    for number, run in enumerate(runs):
        for e, along in run.edges:
            of_half[2 * e + (not along)] = (number, True)
            of_half[2 * e + along] = (number, False)
    following = faces.following.tolist()
    cycles: Cycles = {}
    seen: set[Step] = set()
    for start in sorted(of_half):
        row, step = list[Step](), of_half[start]
        while step not in seen:
            seen.add(step)
            row.append(step)
            number, ahead = step
            e, along = runs[number].edges[-1 if ahead else 0]
            h = following[2 * e + (along != ahead)]
            while not kept[h >> 1]:
                h = following[h ^ 1]
            step = of_half[h]
        if row:
            cycles.setdefault(int(region[faces.face[start]]), []).append(row)
    return cycles


@record
class Edges:
    """n edges. cubics: (n, 4, 2) px; lines: (n,) bool; gone: (n,) bool, those that are part of a node; smooth: the
    pairs of edge ends (edge, 0 or 1) that go on smoothly into one another."""

    cubics: np.ndarray
    lines: np.ndarray
    gone: np.ndarray
    smooth: list[tuple[Link, Link]]


def edges_of_borders(borders: Borders, faces: Faces, sources: Sources) -> Edges:
    """Every run of the borders as a line or cubic between exact nodes."""
    cluster, gone = _clusters(borders, faces)
    ends: dict[int, list[Link]] = defaultdict(list)
    for number in np.flatnonzero(~gone).tolist():
        for k in (0, 1):
            ends[int(cluster[borders.ends[number, k]])].append((number, k))
    places = {c: _place(c, found, borders, faces, sources) for c, found in ends.items()}
    cubics = np.zeros((len(borders.runs), 4, 2))
    lines = np.zeros(len(borders.runs), dtype=bool)
    for number in np.flatnonzero(~gone).tolist():
        a, b = (places[int(cluster[borders.ends[number, k]])] for k in (0, 1))
        cubics[number], lines[number] = _between(borders.runs[number], a, b, sources)
    # Ends at a node go on smoothly that are of one piece that was cut, or of two that were joined so.
    pairs = [
        (a, b)
        for found in ends.values()
        for a, b in combinations(found, 2)
        if a[0] != b[0] and _smooth(*borders.place(a), *borders.place(b), sources)
    ]
    return Edges(cubics, lines, gone, pairs)


def _clusters(borders: Borders, faces: Faces) -> tuple[np.ndarray, np.ndarray]:
    """(V,) the node of each vertex, named by one of them, and (runs,) bool which runs lie within one."""
    lengths = np.array([faces.lengths[[e for e, _ in run.edges]].sum() for run in borders.runs])
    name = np.arange(len(faces.vertices))
    gone = np.zeros(len(lengths), dtype=bool)

    def root(v: int) -> int:
        while name[v] != v:
            name[v] = name[name[v]]
            v = int(name[v])
        return v

    for number in np.argsort(lengths, kind="stable").tolist():
        if lengths[number] >= LEAST_WIDTH:
            break
        a, b = (root(int(v)) for v in borders.ends[number])
        # What would leave nothing of a small region stays.
        gone[number] = a != b
        name[max(a, b)] = min(a, b)
    return np.array([root(v) for v in range(len(name))]), gone


def _place(node: int, ends: list[Link], borders: Borders, faces: Faces, sources: Sources) -> np.ndarray:
    """(2,) px: an anchor of the uppermost shape that runs through a node, else where that crosses another."""
    vertex = faces.vertices[node] / GRID
    found = [*map(borders.place, ends)]
    top = max(int(sources.shape[piece]) for piece, _ in found)
    upper = [each for each in found if sources.shape[each[0]] == top]
    for piece, t in upper:
        if min(t, 1.0 - t) < EXACT:
            return _if_near(sources.cubics[piece, 0 if t < 0.5 else 3], vertex)
    piece, t = upper[0]
    for other, u in found:
        if other == piece:
            continue
        if min(u, 1.0 - u) < EXACT:
            foot = _foot(sources, piece, t, sources.cubics[other, 0 if u < 0.5 else 3])
            return _if_near(sources.at(np.array([piece]), np.array([foot]))[0], vertex)
        met = _crossing(sources.cubics[[piece, other]], np.array([t, u]))
        if met is not None and np.hypot(*(met - vertex)) <= ASTRAY:
            return met
    return _if_near(sources.at(np.array([piece]), np.array([t]))[0], vertex)


def _if_near(place: np.ndarray, vertex: np.ndarray) -> np.ndarray:
    """Return a place, or the vertex where that is too far away."""
    return place if np.hypot(*(place - vertex)) <= ASTRAY else vertex


def _foot(sources: Sources, piece: int, t: float, place: np.ndarray) -> float:
    """The parameter of a piece nearest to a place."""
    u = np.array([[t]])
    for _ in range(ROUNDS):
        u = np.clip(newton_steps(sources.cubics[[piece]], place[None, None], u), 0.0, 1.0)
    return float(u[0, 0])


def _crossing(cubics: np.ndarray, t: np.ndarray) -> np.ndarray | None:
    """The crossing of two cubics (2, 4, 2) near parameters (2,), by Newton's method; None where they run abreast."""
    for _ in range(ROUNDS):
        place, (way, _) = points_at(cubics, t[:, None])[:, 0], derivatives(cubics, t[:, None])
        (ax, ay), (bx, by) = way[:, 0]
        turn = ax * by - ay * bx
        if abs(turn) < 0.02 * np.hypot(ax, ay) * np.hypot(bx, by):
            return None
        dx, dy = place[1] - place[0]
        t = np.clip(t + np.array([dx * by - dy * bx, dx * ay - dy * ax]) / turn, 0.0, 1.0)
    place = points_at(cubics, t[:, None])[:, 0]
    return place[0] if np.hypot(*(place[1] - place[0])) < 1e-3 else None


def _between(run: Run, a: np.ndarray, b: np.ndarray, sources: Sources) -> tuple[np.ndarray, bool]:
    """The part of a run's piece between two nodes, and whether it is a line."""
    cubic = sources.cubics[run.piece]
    t0, t1 = (_foot(sources, run.piece, u, place) for u, place in zip(run.t, (a, b), strict=True))
    if sources.lines[run.piece] or abs(t1 - t0) < EXACT:
        return line_chain(np.stack([a, b])).cubics[0], True
    low, high = sorted((t0, t1))
    part = cubic_parts(cubic_parts(cubic, high)[0], low / high)[1]
    part = part if t0 < t1 else part[::-1]
    part[1] += a - part[0]
    part[2] += b - part[3]
    part[0], part[3] = a, b
    return part, False


def _smooth(p: int, t: float, q: int, u: float, sources: Sources) -> bool:
    if p == q:
        return min(t, 1.0 - t) > EXACT
    return any(
        sources.after[a] == b and sources.smooth[a] and at > 1.0 - EXACT and start < EXACT
        for (a, at), (b, start) in (((p, t), (q, u)), ((q, u), (p, t)))
    )
