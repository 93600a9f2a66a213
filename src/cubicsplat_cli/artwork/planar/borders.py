"""The borders between visible regions, as runs along the drawing's own lines and cubics that meet at nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.planar.faces import Faces
from cubicsplat_cli.artwork.planar.snapping import Sources
from cubicsplat_cli.record import record

_JUMP = 0.5  # of the parameter: where a ring of one piece begins again


@dataclass(eq=False)
class Run:
    """A part of one piece between two vertices. edges: (edge, whether along it), in order; t: parameters at its ends;
    loop: the number of the closed border without nodes that it is of, or -1."""

    piece: int
    t: tuple[float, float]
    edges: list[tuple[int, bool]]
    loop: int = -1


@record
class Borders:
    """runs: all of them. ends: (runs, 2) the vertices at which they begin and end. cycles: of each region (dictionary)
    its closed borders, each a list of (run, whether along it), with the region on the left of it, y upwards."""

    runs: list[Run]
    ends: np.ndarray
    cycles: dict[int, list[list[tuple[int, bool]]]]


def borders_of(faces: Faces, region: np.ndarray, sources: Sources) -> Borders:
    """The borders between the regions (F,) of a planar map."""
    left, right = region[faces.face[0::2]], region[faces.face[1::2]]
    kept = left != right
    runs: list[Run] = []
    loops = 0
    for chain, closed in _chains(faces, kept):
        found = _along_pieces(chain, faces, sources, closed)
        if closed:
            for run in found:
                run.loop = loops
            loops += 1
        runs += found
    ends = np.array([_ends(run, faces) for run in runs], dtype=np.int64).reshape(-1, 2)
    return Borders(runs, ends, _cycles(faces, region, kept, runs))


def _ends(run: Run, faces: Faces) -> tuple[int, int]:
    (first, ahead), (last, onward) = run.edges[0], run.edges[-1]
    start = faces.tail[first] if ahead else faces.head[first]
    return int(start), int(faces.head[last] if onward else faces.tail[last])


def _chains(faces: Faces, kept: np.ndarray) -> list[tuple[list[tuple[int, bool]], bool]]:
    """The edges in rows from node to node, and those in closed rows without nodes (True)."""
    at: dict[int, list[int]] = {}
    for e in np.flatnonzero(kept).tolist():
        at.setdefault(int(faces.tail[e]), []).append(e)
        at.setdefault(int(faces.head[e]), []).append(e)
    left = set(np.flatnonzero(kept).tolist())
    chains = []
    nodes = [v for v, edges in at.items() if len(edges) != 2]
    for v in nodes:
        for e in at[v]:
            if e in left:
                chains.append((_walked(e, v, at, faces, left), False))
    for e in np.flatnonzero(kept).tolist():
        if e in left:
            chains.append((_walked(e, int(faces.tail[e]), at, faces, left), True))
    return chains


def _walked(e: int, v: int, at: dict[int, list[int]], faces: Faces, left: set[int]) -> list[tuple[int, bool]]:
    chain = []
    while e in left:
        left.discard(e)
        ahead = int(faces.tail[e]) == v
        chain.append((e, ahead))
        v = int(faces.head[e]) if ahead else int(faces.tail[e])
        if len(at[v]) != 2:
            break
        e = at[v][0] if at[v][1] == e else at[v][1]
    return chain


def _along_pieces(chain: list[tuple[int, bool]], faces: Faces, sources: Sources, closed: bool) -> list[Run]:
    """The runs of a chain: it keeps to a piece as long as that goes on, then takes the one that follows it."""
    runs: list[Run] = []
    after = sources.after
    for e, ahead in chain:
        found = [(p, (a, b) if ahead else (b, a)) for p, a, b in faces.runs[e]]
        last = runs[-1] if runs else None
        same = next((t for p, t in found if last and p == last.piece and _goes_on(last.t, t)), None)
        if last is not None and same is not None:
            last.t = (last.t[0], same[1])
            last.edges.append((e, ahead))
            continue
        joined = ((p, t) for p, t in found if last and (after[last.piece] == p or after[p] == last.piece))
        runs.append(Run(*next(joined, found[0]), [(e, ahead)]))
    if closed and len(runs) > 1 and runs[0].piece == runs[-1].piece and _goes_on(runs[-1].t, runs[0].t):
        last = runs.pop()
        runs[0] = Run(last.piece, (last.t[0], runs[0].t[1]), last.edges + runs[0].edges)
    return runs


def _goes_on(before: tuple[float, float], after: tuple[float, float]) -> bool:
    same_way = (before[1] > before[0]) == (after[1] > after[0])
    return same_way and abs(after[0] - before[1]) < _JUMP


def _cycles(
    faces: Faces, region: np.ndarray, kept: np.ndarray, runs: list[Run]
) -> dict[int, list[list[tuple[int, bool]]]]:
    of_half: dict[int, tuple[int, bool]] = {}
    for number, run in enumerate(runs):
        for e, ahead in run.edges:
            of_half[2 * e + (not ahead)] = (number, True)
            of_half[2 * e + ahead] = (number, False)
    following = faces.following.tolist()
    cycles: dict[int, list[list[tuple[int, bool]]]] = {}
    seen: set[int] = set()
    for start in sorted(of_half):
        if start in seen:
            continue
        row: list[tuple[int, bool]] = []
        h = start
        while h not in seen:
            seen.add(h)
            if not row or row[-1] != of_half[h]:
                row.append(of_half[h])
            h = following[h]
            while not kept[h >> 1]:
                h = following[h ^ 1]
        if len(row) > 1 and row[0] == row[-1]:
            row.pop()
        cycles.setdefault(int(region[faces.face[start]]), []).append(row)
    return cycles
