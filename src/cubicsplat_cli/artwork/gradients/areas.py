"""Areas in which colours change evenly, and the gradients that they follow.

Within a gradient colours change by straight lines, so second differences are those of rounding; across an edge they are
not. An area that no single gradient explains is divided: what has one colour is left to the inks, and each part of
the rest is looked at by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.gradients.ramps import alike
from cubicsplat_cli.artwork.gradients.shades import Shade, shade_of

# Levels: a second difference that rounding makes, the steepest change per px, and what a gradient explains of a pixel.
BEND, STEEP, CLOSE = 2.6, 12.0, 2.0
NEARLY = 8.0  # levels, of a few pixels that make no area of their own
LEAST_AREA, FEW = 64, 16  # px, of a gradient, and in which one changes
LEAST_RANGE = 3.0  # levels, within which an area has one colour
# Uneven parts of a picture, pieces that one of them is divided into, and gradients sought.
MOST_PARTS, MOST_PIECES, MOST_TRIES = 100, 8, 80
EXPLAINED = 0.95  # share of an area's pixels, for one gradient to be enough
SAME_INK, LEAST_PLATEAU = 1.0, 0.04  # levels around the commonest colour, and share of the area that has it
CLEAR = 0.5  # levels of opacity
ALIKE = 0.4  # share of an area's pixels that another's gradient explains, for one to be sought for both
# Px across which a gradient may go on, px along which it must, and levels by which it may be off there.
GAP, CONTACT, SHARP = 4, 8, 24.0
SAME_RAMP = 2.0  # levels by which two ramps may be off each other, for one to be sought for both
MOST_HINTS = 3
DEEPEST, SEEDS, LEAST_SHARE = 2, 3, 0.3
RING = 4  # px of its surroundings that a part is looked at with
PLUS = ndimage.generate_binary_structure(2, 1)
SQUARE = np.ones((3, 3), dtype=bool)


@dataclass(frozen=True)
class Area:
    """A gradient and where it is seen. mask: (H, W) bool. ground: the colour (4,) in levels of what it fades into
    without an edge, or None; rim: t where it does; inwards: whether the ramp lies below that t."""

    shade: Shade
    mask: np.ndarray
    ground: np.ndarray | None = None
    rim: float = 0.0
    inwards: bool = False


def smooth_parts(levels: np.ndarray, bend: float = BEND) -> tuple[np.ndarray, int]:
    """(H, W) int32 the number of the connected part in which colours change evenly, 0 for edges; and how many.

    bend: levels of a second difference that is none of an edge; as much steeper may changes be.
    """
    around = np.pad(levels, ((1, 1), (1, 1), (0, 0)), mode="reflect", reflect_type="odd")
    height, width = levels.shape[:2]
    smooth, changing = np.ones((height, width), dtype=bool), np.zeros((height, width), dtype=bool)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        after = around[1 + dy : 1 + dy + height, 1 + dx : 1 + dx + width]
        before = around[1 - dy : 1 - dy + height, 1 - dx : 1 - dx + width]
        smooth &= largest(np.abs(after - 2.0 * levels + before)) <= bend
        step = largest(np.abs(after - before))
        smooth &= step <= 2.0 * STEEP * bend / BEND
        changing |= step > 0.0
    # Opened with room around the canvas, so that its border takes nothing away.
    opened = ndimage.binary_opening(np.pad(smooth, 2, mode="edge"), SQUARE)[2:-2, 2:-2]
    # Flat pictures, most drawings, need no more than this.
    if (opened & changing).sum() < FEW:
        return np.zeros((height, width), dtype=np.int32), 0
    return ndimage.label(opened, PLUS)


def gradient_areas(levels: np.ndarray, parts: np.ndarray, count: int, tries: int = MOST_TRIES) -> list[Area]:
    """The gradients of a picture (H, W, 4), premultiplied levels, the largest first.

    None in flat pictures, and in those of more than MOST_PARTS uneven parts, which are photos or textures. tries: how
    often a gradient is sought, after which what is left stays as it is.
    """
    index = np.arange(1, count + 1)
    spread = np.zeros(count)
    for k in range(4):
        high, low = ndimage.maximum(levels[..., k], parts, index), ndimage.minimum(levels[..., k], parts, index)
        spread = np.maximum(spread, np.asarray(high) - np.asarray(low))
    sizes = np.bincount(parts.ravel(), minlength=count + 1)[1:]
    boxes = ndimage.find_objects(parts)
    search = _Search([], tries)
    uneven = np.flatnonzero((sizes >= LEAST_AREA) & (spread > LEAST_RANGE))
    if len(uneven) > MOST_PARTS:
        return []
    for i in uneven[np.argsort(-sizes[uneven], kind="stable")]:
        _explain(Part(levels, parts == i + 1, boxes[i]), search, 0)
    return _united(levels, parts, search.found) if search.found else []


@dataclass
class _Search:
    """The gradients found so far, and how often one may still be sought."""

    found: list[Area]
    left: int

    def shade(self, x: np.ndarray, y: np.ndarray, values: np.ndarray) -> Shade | None:
        """The gradient of pixels; None where none may be sought any more."""
        if self.left <= 0:
            return None
        self.left -= 1
        return shade_of(x, y, values, self.hints())

    def hints(self) -> list[Shade]:
        """The last few radial gradients found."""
        return [shade for shade in {id(a.shade): a.shade for a in self.found}.values() if shade.radial][-MOST_HINTS:]


def _united(levels: np.ndarray, parts: np.ndarray, found: list[Area]) -> list[Area]:
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


class Part:
    """Some pixels of a picture. box: slices that hold them all."""

    def __init__(self, levels: np.ndarray, mask: np.ndarray, box: tuple[slice, slice]) -> None:
        self.levels, self.mask, self.box = levels, mask, box
        rows, columns = np.nonzero(mask[box])
        self.rows, self.columns = rows + box[0].start, columns + box[1].start
        self.x, self.y = self.columns + 0.5, self.rows + 0.5
        self.values = levels[self.rows, self.columns].astype(float)

    def within(self, own: np.ndarray) -> np.ndarray:
        """(H, W) bool: the pixels for which own (n,) holds."""
        mask = np.zeros_like(self.mask)
        mask[self.rows[own], self.columns[own]] = True
        return mask

    def pieces(self, own: np.ndarray) -> list[Part]:
        """The largest connected parts of the pixels for which own (n,) holds, without what is thinner than 3 px."""
        mask = ndimage.binary_opening(self.within(own), SQUARE)
        labels, count = ndimage.label(mask, PLUS)
        boxes = ndimage.find_objects(labels)
        sizes = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        largest = np.argsort(-sizes, kind="stable")[:MOST_PIECES]
        return [Part(self.levels, labels == k + 1, boxes[k]) for k in largest if sizes[k] >= LEAST_AREA]

    def explained(self, shade: Shade) -> np.ndarray:
        """(n,) bool."""
        return np.abs(shade.at(self.x, self.y) - self.values).max(axis=1) <= CLOSE

    def with_rests(self, shade: Shade, known: np.ndarray) -> np.ndarray:
        """(H, W) bool: the explained pixels (n,), and the few that are nearly so."""
        nearly = np.abs(shade.at(self.x, self.y) - self.values).max(axis=1) <= NEARLY
        labels, count = ndimage.label(self.within(nearly & ~known), PLUS)
        if count == 0:
            return self.within(known)
        few = np.bincount(labels.ravel(), minlength=count + 1) < LEAST_AREA
        few[0] = False
        return self.within(known) | few[labels]

    def range(self) -> float:
        low, high = np.percentile(self.values, (2, 98), axis=0)
        return float((high - low).max())


def _explain(part: Part, search: _Search, depth: int) -> None:
    """Adds the gradients of a part to those found."""
    if len(part.x) < LEAST_AREA or part.range() <= LEAST_RANGE or depth > DEEPEST:
        return
    ink, even = plateau(part)
    clear = ink[3] <= CLEAR and even.any()
    if not clear:
        shade = search.shade(part.x, part.y, part.values)
        if shade is None:
            return
        known = part.explained(shade)
        if known.mean() >= EXPLAINED:
            search.found.append(Area(shade, part.with_rests(shade, known)))
            return
    if clear or even.mean() >= LEAST_PLATEAU:
        first = len(search.found)
        for piece in part.pieces(~even):
            _fading(part, piece, ink, search, depth)
        search.found[first:] = [_filled(part, area) for area in search.found[first:]]
        return
    _largest(part, search, depth)


def _filled(part: Part, area: Area) -> Area:
    """The area with its holes that its gradient explains too: bands of it that were taken for another ink."""
    hole = ndimage.binary_fill_holes(area.mask) & ~area.mask
    own = hole[part.rows, part.columns]
    own[own] = np.abs(area.shade.at(part.x[own], part.y[own]) - part.values[own]).max(axis=1) <= CLOSE
    return replace(area, mask=area.mask | part.within(own)) if own.any() else area


def plateau(part: Part) -> tuple[np.ndarray, np.ndarray]:
    """The commonest colour (4,), and which pixels (n,) have it and are not on their way through it."""
    clear = part.values[:, 3] <= CLEAR
    if clear.mean() >= LEAST_PLATEAU:
        return np.zeros(4), clear
    code = np.rint(part.values).astype(np.int64) @ (256 ** np.arange(4))
    _, first, index, counts = np.unique(code, return_index=True, return_inverse=True, return_counts=True)
    best = int(counts.argmax())
    ink = part.values[index.reshape(-1) == best].mean(axis=0)
    near = np.abs(part.values - np.rint(part.values[first[best]])).max(axis=1) <= SAME_INK
    # A gradient passes through its colours in bands; what is even around about is none of them.
    even = ndimage.binary_erosion(part.within(near), SQUARE, iterations=RING)
    even = ndimage.binary_dilation(even, SQUARE, iterations=RING)
    own = near & even[part.rows, part.columns]
    return ink, own


def _fading(whole: Part, piece: Part, ink: np.ndarray, search: _Search, depth: int) -> None:
    """Adds the gradient of a piece of a part that fades into the ink beside it, or else those within the piece."""
    if len(piece.x) < LEAST_AREA or piece.range() <= LEAST_RANGE:
        return
    around = ndimage.binary_dilation(piece.mask, SQUARE, iterations=RING) & whole.mask
    wider = Part(whole.levels, around, _widened(piece.box, around.shape))
    shade = search.shade(wider.x, wider.y, wider.values)
    if shade is None:
        return
    known = wider.explained(shade)
    if known.mean() < EXPLAINED:
        if len(piece.x) < 0.9 * len(whole.x):
            _explain(piece, search, depth + 1)
        return
    fading = _faded(shade, ink)
    if fading is None:
        search.found.append(Area(shade, piece.mask))
        return
    shade, rim, inwards = fading
    t = shade.t(wider.x, wider.y)
    own = known & ((t < rim) if inwards else (t > rim))
    search.found.append(Area(shade, wider.within(own), ink, rim, inwards))


def _faded(shade: Shade, ink: np.ndarray) -> tuple[Shade, float, bool] | None:
    """The shade with its end that has about the ink made exactly that, its t there, and whether the rest is below."""
    colours, knots = shade.ramp.colours.copy(), shade.ramp.knots
    gaps = [float(np.abs(colours[end] - ink).max()) for end in (0, -1)]
    if min(gaps) > CLOSE:
        return None
    last = gaps[1] < gaps[0]
    colours[-1 if last else 0] = ink
    ramp = type(shade.ramp)(knots, colours)
    return Shade(shade.frame, shade.radial, ramp, shade.parameters), float(knots[-1 if last else 0]), last


def _largest(part: Part, search: _Search, depth: int) -> None:
    """Adds the gradient that explains most of a part, of those of SEEDS places in it, and those of the rest."""
    reach = 0.5 * np.sqrt(len(part.x) / 3.0)
    picks = np.linspace(0, len(part.x) - 1, SEEDS + 2).astype(int)[1:-1]
    best, most = None, LEAST_SHARE * len(part.x)
    for pick in picks:
        near = np.maximum(np.abs(part.x - part.x[pick]), np.abs(part.y - part.y[pick])) <= reach
        if near.sum() < LEAST_AREA:
            continue
        shade = search.shade(part.x[near], part.y[near], part.values[near])
        if shade is None:
            break
        known = part.explained(shade)
        if known.sum() > most:
            best, most = known, float(known.sum())
    if best is None:
        return
    shade = search.shade(part.x[best], part.y[best], part.values[best])
    if shade is None:
        return
    known = part.explained(shade)
    search.found.append(Area(shade, part.within(known)))
    for piece in part.pieces(~known):
        _explain(piece, search, depth + 1)


def _widened(box: tuple[slice, slice], shape: tuple[int, ...]) -> tuple[slice, slice]:
    rows, columns = (
        slice(max(side.start - RING, 0), min(side.stop + RING, size)) for side, size in zip(box, shape, strict=False)
    )
    return rows, columns
