"""Areas that one gradient explains together, and what a gradient goes on in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA, SQUARE, Part
from cubicsplat_cli.artwork.gradients.ramps import alike
from cubicsplat_cli.artwork.gradients.shade import Shade, ShadedArea
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage

EXPLAINED = 0.95  # share of an area's pixels, for one gradient to be enough
ALIKE = 0.4  # share of an area's pixels that another's gradient explains, for one to be sought for both
# Px across which a gradient may go on, px along which it must, and levels by which it may be off there.
GAP, CONTACT, SHARP = 4, 8, 24.0
SAME_RAMP = 2.0  # levels by which two ramps may be off each other, for one to be sought for both
MOST_UNIONS = 80  # tried, of which pictures with so many gradients need few: each takes some tenths of a second


def united(levels: np.ndarray, parts: np.ndarray, found: list[ShadedArea]) -> list[ShadedArea]:
    """The areas, those with one gradient where a single one explains them all, and what they continue in."""
    whole = (slice(0, levels.shape[0]), slice(0, levels.shape[1]))
    out = [area for area in found if area.ground is not None]
    groups: list[_Group] = []
    left = MOST_UNIONS
    for area in found:
        if area.ground is not None:
            continue
        work().at()
        part, near = Part(levels, area.mask, whole), _around(area.mask)
        for group in groups:
            likely = left > 0 and (
                part.explained(group.shade.extended()).mean() >= ALIKE
                or alike(area.shade.ramp, group.shade.ramp) <= SAME_RAMP
                or _meets(group, area, near)
            )
            if likely:
                left -= 1
                one = _one(levels, [*group.members, part], [group.shade, area.shade])
                if one is not None:
                    group.shade, group.near = one, group.near | near
                    group.members.append(part)
                    break
        else:
            groups.append(_Group(area.shade, [part], near))
    claimed = np.logical_or.reduce([area.mask for area in found])
    for group in groups:
        _continue(levels, parts, claimed, group)
    return out + [ShadedArea(group.shade, part.mask) for group in groups for part in group.members]


@dataclass
class _Group:
    """Parts that share a gradient. near: (H, W) bool, what is `_around` them."""

    shade: Shade
    members: list[Part]
    near: np.ndarray


def _around(mask: np.ndarray) -> np.ndarray:
    """(H, W) bool: within GAP px of a mask."""
    return ndimage.binary_dilation(mask, SQUARE, iterations=GAP)


def _meets(group: _Group, area: ShadedArea, near: np.ndarray) -> bool:
    """Whether the ramps of a group and an area, carried on, have about the same colours between the two. near: what is
    `_around` the area.
    """
    y, x = np.nonzero(group.near & near)
    if len(y) < CONTACT:
        return False
    first, second = (shade.extended().at(x + 0.5, y + 0.5) for shade in (group.shade, area.shade))
    return bool(np.median(np.abs(first - second).max(axis=1)) <= SHARP)


def _continues(group: _Group, part: Part) -> bool:
    """Whether a part begins, within GAP px, about as a group ends: stops where a ramp bends sharply look like edges."""
    own = group.near[part.rows, part.columns]
    if own.sum() < CONTACT:
        return False
    off = group.shade.extended().at(part.x[own], part.y[own]) - part.values[own]
    return bool(np.median(np.abs(off).max(axis=1)) <= SHARP)


def _continue(levels: np.ndarray, parts: np.ndarray, claimed: np.ndarray, group: _Group) -> None:
    """Adds to a group the even parts beside it that its ramp ends in, and the pixels between that it explains."""
    near = group.near
    names, sizes = np.unique(parts[near & ~claimed & (parts > 0)], return_counts=True)
    whole = (slice(0, levels.shape[0]), slice(0, levels.shape[1]))
    for name in names[sizes >= CONTACT]:
        part = Part(levels, (parts == name) & ~claimed, whole)
        if len(part.x) >= LEAST_AREA and _continues(group, part):
            one = _one(levels, [*group.members, part], [group.shade])
            if one is not None:
                group.shade = one
                group.members.append(part)
                group.near = group.near | _around(part.mask)
                claimed |= part.mask
    between = near & ~claimed & (parts == 0)
    if len(group.members) < 2 or not between.any():
        return
    strip = Part(levels, between, whole)
    known = strip.within(strip.explained(group.shade))
    group.members[0] = Part(levels, group.members[0].mask | known, whole)
    claimed |= known


def _one(levels: np.ndarray, members: list[Part], hints: list[Shade]) -> Shade | None:
    """The gradient that explains all of these, if there is one."""
    whole = (slice(0, levels.shape[0]), slice(0, levels.shape[1]))
    union = Part(levels, np.logical_or.reduce([part.mask for part in members]), whole)
    shade = shade_of(union.x, union.y, union.values, hints)
    # One that needs more stops than any of them only strings them together.
    if len(shade.ramp.knots) > 1 + max(len(hint.ramp.knots) for hint in hints):
        return None
    return shade if all(part.explained(shade).mean() >= EXPLAINED for part in members) else None
