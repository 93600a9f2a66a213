"""Areas that one gradient explains together, and what a gradient goes on in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA, Part, Patch, joined, part_of
from cubicsplat_cli.artwork.gradients.shade import CLOSE, Shade, ShadedArea, alike
from cubicsplat_cli.artwork.gradients.shades import common_shade
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster.shades import Pixels

EXPLAINED = 0.95  # share of an area's pixels, for one gradient to be enough
ALIKE = 0.4  # share of an area's pixels that another's gradient explains, for one to be sought for both
# Px across which a gradient may go on, px along which it must, and levels by which it may be off there.
GAP, CONTACT, SHARP = 4, 8, 24.0
SAME_RAMP = 2.0  # levels by which two ramps may be off each other, for one to be sought for both
# Other gradients with which one is sought for an area, those that explain most of it first, and how many of its pixels
# tell that.
MOST_UNIONS, LOOKED_AT = 6, 128


def united(levels: np.ndarray, parts: np.ndarray, boxes: np.ndarray, found: list[ShadedArea]) -> list[ShadedArea]:
    """The areas, those with one gradient where a single one explains them all, and what they continue in.

    parts: (H, W) numbers from 1 on of what changes evenly, 0 for edges; boxes: of each its first and last row and
    column.
    """
    out = [area for area in found if area.ground is not None]
    groups: list[_Group] = []
    for area in found:
        if area.ground is None:
            work().at()
            _unite(levels, area, groups)
    claimed = np.zeros(levels.shape[:2], dtype=bool)
    for area in found:
        claimed[area.patch.window] |= area.patch.mask
    for group in groups:
        _continue(levels, parts, boxes, claimed, group)
    return out + [ShadedArea(group.shade, part.patch) for group in groups for part in group.members]


@dataclass(eq=False)
class _Group:
    """Parts that share a gradient. near: what is within GAP px of them."""

    shade: Shade
    members: list[Part]
    near: Patch

    def __post_init__(self) -> None:
        """extended: the gradient, carried on; low, high: (4,) levels between which its colours are."""
        self.extended = self.shade.extended()
        self.low, self.high = (end(self.extended.ramp.colours, axis=0) for end in (np.min, np.max))


def _unite(levels: np.ndarray, area: ShadedArea, groups: list[_Group]) -> None:
    """Adds an area to the group with which it shares a gradient, or as a group of its own."""
    part = Part(levels, area.patch)
    own = _Group(area.shade, [part], area.patch.grown(GAP, levels.shape))
    for k in _promising(groups, own)[:MOST_UNIONS]:
        group = groups[k]
        one = _one([*group.members, part], [group.shade, area.shade])
        if one is not None:
            groups[k] = _Group(one, [*group.members, part], joined([group.near, own.near]))
            return
    groups.append(own)


def _promising(groups: list[_Group], own: _Group) -> list[int]:
    """The numbers of groups that may share a gradient with another one of a single part, the likeliest first."""
    if not groups:
        return []
    part = own.members[0]
    some = part.pixels.some(np.linspace(0, len(part) - 1, min(len(part), LOOKED_AT)).astype(int))
    low, high = np.array([g.low for g in groups]) - CLOSE, np.array([g.high for g in groups]) + CLOSE
    within = (some.values >= low[:, None]) & (some.values <= high[:, None])
    shares = np.zeros(len(groups))
    for k in np.flatnonzero(within.all(axis=2).mean(axis=1) >= ALIKE):
        shares[k] = groups[k].extended.explains(some).mean()
    coloured = ((low <= own.high + CLOSE) & (high >= own.low - CLOSE)).all(axis=1)
    return [
        k
        for k in np.argsort(-shares, kind="stable").tolist()
        if shares[k] >= ALIKE or (coloured[k] and alike(own.shade.ramp, groups[k].shade.ramp) <= SAME_RAMP)
    ]


def _continue(levels: np.ndarray, parts: np.ndarray, boxes: np.ndarray, claimed: np.ndarray, group: _Group) -> None:
    """Adds to a group the even parts beside it that its ramp ends in, and the pixels between that it explains."""
    near = group.near
    beside = near.mask & ~claimed[near.window]
    names, sizes = np.unique(parts[near.window][beside], return_counts=True)
    for name in names[(sizes >= CONTACT) & (names > 0)]:
        part = part_of(levels, parts, name, boxes[name - 1], claimed)
        own = group.near.at(part.rows, part.columns)
        if len(part) < LEAST_AREA or own.sum() < CONTACT:
            continue
        # It begins about as the group ends: stops where a ramp bends sharply look like edges.
        if np.median(group.shade.extended().off(part.pixels.some(own))) <= SHARP:
            one = _one([*group.members, part], [group.shade])
            if one is not None:
                group.shade = one
                group.members.append(part)
                group.near = joined([group.near, part.patch.grown(GAP, levels.shape)])
                claimed[part.patch.window] |= part.patch.mask
    between = near.mask & ~claimed[near.window] & (parts[near.window] == 0)
    if len(group.members) < 2 or not between.any():
        return
    strip = Part(levels, Patch(near.top, near.left, between))
    known = strip.within(group.shade.explains(strip.pixels))
    group.members[0] = Part(levels, joined([group.members[0].patch, known]))
    claimed[known.window] |= known.mask


def _one(members: list[Part], hints: list[Shade]) -> Shade | None:
    """The gradient that explains all of these, if there is one."""
    x, y, values = (np.concatenate(arrays) for arrays in zip(*(part.pixels for part in members), strict=True))
    shade = common_shade(Pixels(x, y, values), hints)
    # One that needs more stops than any of them only strings them together.
    if shade is None or len(shade.ramp.knots) > 1 + max(len(hint.ramp.knots) for hint in hints):
        return None
    return shade if all(shade.explains(part.pixels).mean() >= EXPLAINED for part in members) else None
