"""Areas that one gradient explains together, and what a gradient goes on in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA, SQUARE, Part
from cubicsplat_cli.artwork.gradients.ramps import alike
from cubicsplat_cli.artwork.gradients.shade import Area, Shade
from cubicsplat_cli.artwork.gradients.shades import shade_of

EXPLAINED = 0.95  # share of an area's pixels, for one gradient to be enough
ALIKE = 0.4  # share of an area's pixels that another's gradient explains, for one to be sought for both
# Px across which a gradient may go on, px along which it must, and levels by which it may be off there.
GAP, CONTACT, SHARP = 4, 8, 24.0
SAME_RAMP = 2.0  # levels by which two ramps may be off each other, for one to be sought for both


def united(levels: np.ndarray, parts: np.ndarray, found: list[Area]) -> list[Area]:
    """The areas, those with one gradient where a single one explains them all, and what they continue in."""
    whole = (slice(0, levels.shape[0]), slice(0, levels.shape[1]))
    out = [area for area in found if area.ground is not None]
    groups: list[_Group] = []
    for area in found:
        if area.ground is not None:
            continue
        part = Part(levels, area.mask, whole)
        for k, group in enumerate(groups):
            likely = (
                part.explained(group.shade.extended()).mean() >= ALIKE
                or alike(area.shade.ramp, group.shade.ramp) <= SAME_RAMP
                or _meets(group, area)
            )
            if likely:
                one = _one(levels, [*group.members, part], [group.shade, area.shade])
                if one is not None:
                    groups[k] = _Group(one, [*group.members, part])
                    break
        else:
            groups.append(_Group(area.shade, [part]))
    claimed = np.logical_or.reduce([area.mask for area in found])
    for group in groups:
        _continue(levels, parts, claimed, group)
    return out + [Area(group.shade, part.mask) for group in groups for part in group.members]


@dataclass
class _Group:
    """Parts that share a gradient."""

    shade: Shade
    members: list[Part]


def _meets(group: _Group, area: Area) -> bool:
    """Whether the ramps of a group and an area, carried on, have about the same colours between the two."""
    near = np.logical_or.reduce([ndimage.binary_dilation(p.mask, SQUARE, iterations=GAP) for p in group.members])
    y, x = np.nonzero(near & ndimage.binary_dilation(area.mask, SQUARE, iterations=GAP))
    if len(y) < CONTACT:
        return False
    first, second = (shade.extended().at(x + 0.5, y + 0.5) for shade in (group.shade, area.shade))
    return bool(np.median(np.abs(first - second).max(axis=1)) <= SHARP)


def _continues(group: _Group, part: Part) -> bool:
    """Whether a part begins, within GAP px, about as a group ends: stops where a ramp bends sharply look like edges."""
    near = np.logical_or.reduce([ndimage.binary_dilation(p.mask, SQUARE, iterations=GAP) for p in group.members])
    own = near[part.rows, part.columns]
    if own.sum() < CONTACT:
        return False
    off = group.shade.extended().at(part.x[own], part.y[own]) - part.values[own]
    return bool(np.median(np.abs(off).max(axis=1)) <= SHARP)


def _continue(levels: np.ndarray, parts: np.ndarray, claimed: np.ndarray, group: _Group) -> None:
    """Adds to a group the even parts beside it that its ramp ends in, and the pixels between that it explains."""
    own = np.logical_or.reduce([part.mask for part in group.members])
    near = ndimage.binary_dilation(own, SQUARE, iterations=GAP)
    names, sizes = np.unique(parts[near & ~claimed & (parts > 0)], return_counts=True)
    whole = (slice(0, levels.shape[0]), slice(0, levels.shape[1]))
    for name in names[sizes >= CONTACT]:
        part = Part(levels, (parts == name) & ~claimed, whole)
        if len(part.x) >= LEAST_AREA and _continues(group, part):
            one = _one(levels, [*group.members, part], [group.shade])
            if one is not None:
                group.shade = one
                group.members.append(part)
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
