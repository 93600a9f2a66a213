"""The gradients that the even parts of a picture follow, and the parts that share one.

A part that no single gradient explains is divided. Pixels of one colour become a fill, and every piece of the rest is
examined by itself.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.artwork.gradients.parts import LEAST_AREA, RING, Part, Parts, Patch, joined, joined_pixels
from cubicsplat_cli.artwork.gradients.shade import CLOSE, Shade, ShadedArea, alike, by_gradient, covered
from cubicsplat_cli.artwork.gradients.shades import common_shade, reaching, shade_of
from cubicsplat_cli.artwork.regions.fills import APART, CONTACT, FLAT_RANGE, SEEN
from cubicsplat_cli.progress import log, work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels

EXPLAINED = 0.95  # share of an area's pixels that one gradient must explain
MOST_TRIES = 800  # gradients sought in a picture, some hundredths of a second each
DEEPEST = 2  # divisions of a part into pieces
SEEDS = 3  # places in a part where a gradient is sought
# Share of a part that one of these must explain, and of an area that another's gradient must, for a common one.
LEAST_SHARE = 0.3
RIM, LONGEST_TIP = 2, 40  # px beyond an even part that its edge blurs, and that a tip goes on
LOOKED_AT = 128  # pixels of an area that tell which gradients are likely


def gradient_areas(parts: Parts, tries: int = MOST_TRIES, most: int = MOST_TRIES) -> list[ShadedArea]:
    """Return the gradients of a picture, by its even parts, the largest first. A picture of more than `most` uneven
    ones is a photo or a texture, and has none. After `tries` searches the rest stays as it is. Both are logged unless
    the caller chose the bound."""
    uneven = parts.uneven(LEAST_AREA, FLAT_RANGE)
    if len(uneven) > most:
        if most == MOST_TRIES:
            log.warning("%d areas of uneven colour are too many: they are drawn without gradients", len(uneven))
        return []
    search = _Search([], tries)
    for number in uneven:
        work().at()
        _explain(parts.part(number), search, 0)
    if search.left == 0 and tries == MOST_TRIES:
        log.warning("the smallest of %d areas of uneven colour are drawn without gradients", len(uneven))
    return _with_small_parts(parts, _united(parts, search.found))


@dataclass(eq=False)
class _Search:
    """Gradients found, and the number of searches that are left."""

    found: list[ShadedArea]
    left: int

    def shade(self, pixels: Pixels) -> Shade | None:
        """Return the gradient of pixels; None if no search is left."""
        if self.left <= 0:
            return None
        self.left -= 1
        return shade_of(pixels)


def _explain(part: Part, search: _Search, depth: int) -> None:
    """Add the gradients of a part to those found."""
    if depth > DEEPEST or part.range() <= FLAT_RANGE:
        return
    fill, even = part.plateau()
    if (shade := search.shade(part.pixels)) is None:
        return
    off = shade.off(part.pixels)
    if (off <= CLOSE).mean() >= EXPLAINED:
        search.found.append(ShadedArea(shade, _with_rests(part, off)))
    elif even.any():
        for piece in part.pieces(~even):
            _fading(part, piece, fill, search, depth)
    else:
        _largest(part, search, depth)


def _with_rests(part: Part, off: np.ndarray) -> Patch:
    """Return the pixels that a gradient explains, and small groups that it nearly does. off: (n,) levels from it."""
    nearly = part.within((off > CLOSE) & (off <= SEEN)).mask
    large, _ = ndimage.large_parts(nearly, LEAST_AREA)
    return replace(part.patch, mask=part.within(off <= SEEN).mask & (large == 0))


def _fading(whole: Part, piece: Part, fill: np.ndarray, search: _Search, depth: int) -> None:
    """Add the gradient of a piece that fades into the fill around it, or else the gradients within the piece."""
    if piece.range() <= FLAT_RANGE:
        return
    wider = whole.around(piece)
    if (shade := search.shade(wider.pixels)) is None:
        return
    explained = shade.explains(wider.pixels)
    if explained.mean() < EXPLAINED:
        _explain(piece, search, depth + 1)
        return
    # The end of the ramp that has nearly the fill gets exactly the fill.
    gaps = [float(np.abs(shade.ramp.colours[end] - fill).max()) for end in (0, -1)]
    if min(gaps) > CLOSE:
        search.found.append(ShadedArea(shade, piece.patch))
        return
    end = -1 if gaps[1] < gaps[0] else 0
    colours, rim = shade.ramp.colours.copy(), shade.ramp.knots[end]
    colours[end] = fill
    shade = replace(shade, ramp=replace(shade.ramp, colours=colours), open=(False, False))
    t = shade.t(*wider.pixels[:2])
    shown = explained & ((t < rim) if end else (t > rim))
    search.found.append(ShadedArea(shade, wider.within(shown), fill, end))


def beside(part: Part, width: float = 1.0) -> Iterator[np.ndarray]:
    """Yield the numbers (n,) of the pixels around each of SEEDS places in a part, in squares of `width` times the side
    of one of a third of its area, if they are enough for a gradient."""
    reach = 0.5 * width * np.sqrt(len(part) / 3.0)
    x, y, _ = part.pixels
    for seed in np.linspace(0, len(part) - 1, SEEDS + 2).astype(int)[1:-1]:
        near = np.flatnonzero(np.maximum(np.abs(x - x[seed]), np.abs(y - y[seed])) <= reach)
        if len(near) >= LEAST_AREA:
            yield near


def _largest(part: Part, search: _Search, depth: int) -> None:
    """Add the gradient that explains most of a part, of SEEDS places in it, and the gradients of the rest."""
    best: tuple[Shade, np.ndarray] | None = None
    most = LEAST_SHARE * len(part)
    for near in beside(part):
        if (shade := search.shade(part.pixels.some(near))) is None:
            break
        off = shade.off(part.pixels)
        if (explained := (off <= CLOSE).sum()) > most:
            best, most = (shade, off), float(explained)
    if best is None:
        return
    shade, off = best
    if (again := search.shade(part.pixels.some(off <= CLOSE))) is None:
        return
    # The fit to all these pixels may have another geometry, which explains fewer.
    if ((other := again.off(part.pixels)) <= CLOSE).sum() >= most:
        shade, off = again, other
    search.found.append(ShadedArea(shade, _with_rests(part, off)))
    for piece in part.pieces(off > CLOSE):
        _explain(piece, search, depth + 1)


def _united(parts: Parts, found: list[ShadedArea]) -> list[ShadedArea]:
    """Return the areas, with one gradient for all that it explains, and with the parts in which they continue."""
    groups, claimed = list[_Group](), covered(found, parts.numbers.shape)
    for area in found:
        if area.ground is None:
            work().at()
            _unite(parts.levels, area, groups)
    for group in groups:
        _continue(parts, claimed, group)
    fading = [area for area in found if area.ground is not None]
    return fading + [ShadedArea(group.shade, part.patch) for group in groups for part in group.members]


@dataclass(eq=False)
class _Group:
    """Parts that share a gradient. near: the pixels within RING px of them."""

    shade: Shade
    members: list[Part]
    near: Patch

    def __post_init__(self) -> None:
        """extended: the gradient with its ends carried on; low, high: (4,) levels between which its colours lie."""
        self.extended = self.shade.extended()
        self.low, self.high = (end(self.extended.ramp.colours, axis=0) for end in (np.min, np.max))


def _unite(levels: np.ndarray, area: ShadedArea, groups: list[_Group]) -> None:
    """Add an area to the group with which it shares a gradient, or as a group of its own."""
    part = Part(levels, area.patch)
    alone = _Group(area.shade, [part], area.patch.grown(RING, levels.shape))
    for k in _promising(groups, alone):
        members = [*groups[k].members, part]
        if (shade := _common(members, [groups[k].shade, area.shade])) is not None:
            groups[k] = _Group(shade, members, joined([groups[k].near, alone.near]))
            return
    groups.append(alone)


def _promising(groups: list[_Group], alone: _Group) -> list[int]:
    """Return the numbers of groups that may share a gradient with a group of one part, the likeliest first."""
    if not groups:
        return []
    part = alone.members[0]
    some = part.pixels.some(np.linspace(0, len(part) - 1, min(len(part), LOOKED_AT)).astype(int))
    low, high = np.array([g.low for g in groups]) - CLOSE, np.array([g.high for g in groups]) + CLOSE
    within = (some.values >= low[:, None]) & (some.values <= high[:, None])
    shares = np.zeros(len(groups))
    for k in np.flatnonzero(within.all(axis=2).mean(axis=1) >= LEAST_SHARE):
        shares[k] = groups[k].extended.explains(some).mean()
    overlapping = ((low <= alone.high + CLOSE) & (high >= alone.low - CLOSE)).all(axis=1)
    return [
        k
        for k in np.argsort(-shares, kind="stable").tolist()
        if shares[k] >= LEAST_SHARE or (overlapping[k] and alike(alone.shade.ramp, groups[k].shade.ramp) <= CLOSE)
    ]


def with_tips(parts: Parts, areas: list[ShadedArea]) -> list[ShadedArea]:
    """Return the areas with the pixels beside them, on no even part, that go on in their gradients: tips of shapes, too
    thin to be seen as even."""
    levels, free = parts.levels, (parts.numbers == 0) & ~covered(areas, parts.numbers.shape)
    out = [area for area in areas if area.ground is not None]
    for area in [*by_gradient(area for area in areas if area.plain), *(area for area in areas if area.over)]:
        patch = area.patch.padded(LONGEST_TIP, levels.shape)
        if (outside := free[patch.window]).any():
            near = Part(levels, replace(patch, mask=outside))
            explained = near.within(_goes_on(area, near.pixels)).mask
            # Along an edge of little contrast the rim is explained as well, which tells where the edge lies.
            beyond = explained & ~ndimage.binary_dilation(patch.mask, ndimage.SQUARE, iterations=RIM)
            tips = explained & ndimage.binary_dilation(beyond, ndimage.SQUARE, iterations=RIM)
            patch = replace(patch, mask=ndimage.binary_propagation(patch.mask, None, tips))
            free[patch.window] &= ~patch.mask
        shade = reaching(area.shade, patch.pixels(levels)) if area.plain else area.shade
        out.append(replace(area, shade=shade, patch=patch))
    return out


def _goes_on(area: ShadedArea, pixels: Pixels) -> np.ndarray:
    """Return (n,) bool: True for pixels near an area that its gradients explain."""
    if area.over:
        return area.off(pixels) <= CLOSE
    shade = area.shade.extended()
    # Where the ramp has ended a gradient is like a fill, whose tips these may be as well.
    t, (first, *_, last) = shade.t(*pixels[:2]), shade.ramp.knots
    return shade.explains(pixels) & (t >= first) & (t <= last)


def _with_small_parts(parts: Parts, areas: list[ShadedArea]) -> list[ShadedArea]:
    """Return the areas with the uneven parts that are too small to show a gradient and follow one of theirs, as pieces
    of thin stripes do."""
    shades = list(dict.fromkeys(area.shade for area in areas if area.ground is None))
    if not shades:
        return areas
    taken, count = covered(areas, parts.numbers.shape), parts.count + 1
    free = np.where(taken, 0, parts.numbers)
    sizes = np.bincount(free.ravel(), minlength=count)
    small = np.append(False, parts.measured[2] > 0.0) & (sizes > 0) & (sizes < LEAST_AREA)
    if not small.any():
        return areas
    patch = Patch(0, 0, small[free])
    pixels, numbers = patch.pixels(parts.levels), free[patch.mask]
    explained = [np.bincount(numbers, shade.extended().explains(pixels), count) for shade in shades]
    most, which = np.max(explained, axis=0), np.argmax(explained, axis=0)
    follow = np.flatnonzero(small & (most >= EXPLAINED * sizes)).tolist()
    return areas + [ShadedArea(shades[which[k]], parts.part(k, taken).patch) for k in follow]


def _continue(parts: Parts, claimed: np.ndarray, group: _Group) -> None:
    """Add to a group the even parts beside it in which its ramp ends, and the pixels between that it explains. claimed:
    (H, W) bool, the pixels that have a gradient."""
    levels, near = parts.levels, group.near
    numbers, sizes = np.unique(parts.numbers[near.window][near.mask & ~claimed[near.window]], return_counts=True)
    for number in numbers[(sizes >= CONTACT) & (numbers > 0)]:
        part = parts.part(number, claimed)
        touching = part.pixels.some(group.near.at(part.rows, part.columns))
        # The part begins about as the group ends. A stop where the ramp bends sharply looks like an edge.
        if len(part) < LEAST_AREA or np.median(group.shade.extended().off(touching)) > APART:
            continue
        members = [*group.members, part]
        if (shade := _common(members, [group.shade])) is not None:
            group.shade, group.members = shade, members
            group.near = joined([group.near, part.patch.grown(RING, levels.shape)])
            claimed[part.patch.window] |= part.patch.mask
    between = near.mask & ~claimed[near.window] & (parts.numbers[near.window] == 0)
    if len(group.members) < 2 or not between.any():
        return
    strip = Part(levels, Patch(near.top, near.left, between))
    explained = strip.within(group.shade.explains(strip.pixels))
    group.members[0] = Part(levels, joined([group.members[0].patch, explained]))
    claimed[explained.window] |= explained.mask


def _common(members: list[Part], hints: list[Shade]) -> Shade | None:
    """Return the gradient that explains all of some parts; None if there is none."""
    shade = common_shade(joined_pixels([part.pixels for part in members]), hints)
    # A gradient that needs more stops than any of them only strings them together.
    if shade is None or len(shade.ramp.knots) > 1 + max(len(hint.ramp.knots) for hint in hints):
        return None
    return shade if all(shade.explains(part.pixels).mean() >= EXPLAINED for part in members) else None
