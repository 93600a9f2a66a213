"""Moves of the finish: where the pixels ask for more than an outline's pieces can do, it gets a piece more.

Every move is tried with a short finish, and kept only where the description of the picture becomes shorter: half of
chi^2 over the pixels that the outline crosses, plus a price for every parameter.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.artwork.edits import cornered, curved, divided, rounded
from cubicsplat_cli.artwork.finish import WHITE, Layer, State, View
from cubicsplat_cli.artwork.freedom import Freedom, freedom_of
from cubicsplat_cli.artwork.outlines import Ring

# Coverages are known to this much: drawing programs take 4x4 samples a pixel.
SHARE_SIGMA = 0.04
PRICE = 8.0  # nats a parameter
# Half of chi^2 beyond what chance gives from which a piece is worth looking at; a pixel counts at most MOST_CHI.
WORTH, MOST_CHI = 25.0, 60.0
NEAR = 2.5  # px: misfit within this of a joint is the joint's
CONCENTRATED = 0.5
LEAST_LENGTH = 3.0  # px of a piece that may be cut


@dataclass(frozen=True)
class Complaint:
    """What the pixels hold against a piece. chi: half of the excess of chi^2; t: the parameter in its middle; start,
    end: the shares of it near the piece's ends."""

    chi: float
    t: float
    start: float
    end: float


def with_moves(state: State, canvas: tuple[int, int], detail: float) -> tuple[list[Layer], np.ndarray]:
    """Layers with a piece more wherever the pixels ask for one, and which outlines have changed (outlines,) bool."""
    layers, changed = [], []
    for layer, view in zip(state.layers, state.views, strict=True):
        found = complaints(layer, view, state.misfit)
        outlines: list[Freedom] = []
        first = 0
        for outline in layer.outlines:
            own = {i - first: c for i, c in found.items() if first <= i < first + len(outline.lines)}
            first += len(outline.lines)
            better = _edited(outline, {i: c for i, c in own.items() if c.chi * detail > WORTH}, canvas)
            outlines.append(better or outline)
            changed.append(better is not None)
        layers.append(replace(layer, outlines=outlines))
    return layers, np.array(changed)


def complaints(layer: Layer, view: View, misfit: np.ndarray) -> dict[int, Complaint]:
    """The complaints against the pieces of a layer, numbered through its outlines."""
    edges = view.edges
    floor = SHARE_SIGMA**2 * ((view.slope * WHITE) ** 2).sum(axis=1)
    seen = floor > 1e-7
    chi = np.where(seen, np.minimum(misfit[view.pixels] / np.maximum(floor, 1e-7), MOST_CHI) - 1.0, 0.0)
    # A pixel counts once for each piece that crosses it, at the middle of its edges there.
    place = np.searchsorted(view.pixels, view.flat)
    key, inverse, counts = np.unique(edges.cubic * len(view.pixels) + place, return_inverse=True, return_counts=True)
    piece, pixel = np.divmod(key, len(view.pixels))
    t = np.bincount(inverse.reshape(-1), edges.t) / counts
    cubics = np.concatenate([o.cubics for o in layer.outlines])
    lengths = np.hypot(*np.diff(cubics, axis=1).transpose(2, 0, 1)).sum(axis=1)
    out = {}
    for i in np.unique(piece):
        own = piece == i
        weight, at = np.maximum(chi[pixel[own]], 0.0), t[own]
        total = float(weight.sum())
        excess = 0.5 * float(chi[pixel[own]].sum())
        if excess > 0.0 and total > 0.0:
            along = at * lengths[i]
            middle = float((weight * at).sum() / total)
            start = float(weight[along < NEAR].sum() / total)
            out[int(i)] = Complaint(excess, middle, start, float(weight[along > lengths[i] - NEAR].sum() / total))
    return out


def _edited(outline: Freedom, found: dict[int, Complaint], canvas: tuple[int, int]) -> Freedom | None:
    """The outline with the moves that its complaints suggest, from the last piece on; None without any."""
    ring = outline.outline().ring()
    if not found or not isinstance(outline.outline(), Ring):
        return None
    done = ring
    joints: set[int] = set()
    for i in sorted(found, reverse=True):
        done = _move(done, i, found[i], joints)
    return None if done is ring else freedom_of(done, *canvas)


def _move(ring: Ring, i: int, complaint: Complaint, joints: set[int]) -> Ring:
    length = float(np.hypot(*np.diff(ring.cubics[i], axis=0).T).sum())
    if max(complaint.start, complaint.end) > CONCENTRATED and length > 2.0 * NEAR:
        anchor = i if complaint.start >= complaint.end else (i + 1) % ring.pieces
        if anchor in joints or anchor == 0:
            return ring
        joints.add(anchor)
        if ring.smooth[anchor]:
            return cornered(ring, anchor)
        return rounded(ring, anchor, 2.0)
    if length < LEAST_LENGTH:
        return ring
    if ring.lines[i]:
        return curved(ring, i)
    return divided(ring, i, float(np.clip(complaint.t, 0.25, 0.75)))


def shorter(before: State, after: State, changed: np.ndarray, detail: float) -> np.ndarray:
    """(outlines,) bool: which changed outlines make the whole description longer rather than shorter."""
    worse, number = [], 0
    for old, new, a, b in zip(before.layers, after.layers, before.views, after.views, strict=True):
        for k in range(len(old.outlines)):
            if changed[number]:
                worse.append(_gain(before, after, old, new, a, b, k) * detail < _cost(old, new, k))
            else:
                worse.append(False)
            number += 1
    return np.array(worse)


def _cost(old: Layer, new: Layer, k: int) -> float:
    return PRICE * (new.outlines[k].outline().parameters - old.outlines[k].outline().parameters)


def _gain(before: State, after: State, old: Layer, new: Layer, a: View, b: View, k: int) -> float:
    """By how much half of chi^2 falls on the pixels that an outline crosses before or after."""
    pixels = np.union1d(a.of(old, k), b.of(new, k))
    slopes = ((a.slope[np.isin(a.pixels, pixels)] * WHITE) ** 2).sum(axis=1)
    floor = SHARE_SIGMA**2 * max(float(np.median(slopes)) if len(slopes) else 0.0, 1e-4)
    return 0.5 * float((before.misfit[pixels] - after.misfit[pixels]).sum()) / floor
