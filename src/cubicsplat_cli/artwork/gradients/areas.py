"""The gradients that the even parts of a picture follow.

An area that no single gradient explains is divided: what has one colour is left to the inks, and each part of the rest
is looked at by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.artwork.gradients.parts import (
    CLEAR,
    CLOSE,
    LEAST_AREA,
    LEAST_PLATEAU,
    RING,
    SQUARE,
    Part,
    plateau,
    widened,
)
from cubicsplat_cli.artwork.gradients.shade import Shade, ShadedArea
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.gradients.uniting import EXPLAINED, united
from cubicsplat_cli.raster import ndimage

LEAST_RANGE = 3.0  # levels, within which an area has one colour
# Uneven parts of a picture, and gradients sought.
MOST_PARTS, MOST_TRIES = 100, 80
MOST_HINTS = 3
DEEPEST, SEEDS, LEAST_SHARE = 2, 3, 0.3


def gradient_areas(levels: np.ndarray, parts: np.ndarray, count: int, tries: int = MOST_TRIES) -> list[ShadedArea]:
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
    return united(levels, parts, search.found) if search.found else []


@dataclass
class _Search:
    """The gradients found so far, and how often one may still be sought."""

    found: list[ShadedArea]
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
            search.found.append(ShadedArea(shade, part.with_rests(shade, known)))
            return
    if clear or even.mean() >= LEAST_PLATEAU:
        first = len(search.found)
        for piece in part.pieces(~even):
            _fading(part, piece, ink, search, depth)
        search.found[first:] = [_filled(part, area) for area in search.found[first:]]
        return
    _largest(part, search, depth)


def _filled(part: Part, area: ShadedArea) -> ShadedArea:
    """The area with its holes that its gradient explains too: bands of it that were taken for another ink."""
    hole = ndimage.binary_fill_holes(area.mask) & ~area.mask
    own = hole[part.rows, part.columns]
    own[own] = np.abs(area.shade.at(part.x[own], part.y[own]) - part.values[own]).max(axis=1) <= CLOSE
    return replace(area, mask=area.mask | part.within(own)) if own.any() else area


def _fading(whole: Part, piece: Part, ink: np.ndarray, search: _Search, depth: int) -> None:
    """Adds the gradient of a piece of a part that fades into the ink beside it, or else those within the piece."""
    if len(piece.x) < LEAST_AREA or piece.range() <= LEAST_RANGE:
        return
    around = ndimage.binary_dilation(piece.mask, SQUARE, iterations=RING) & whole.mask
    wider = Part(whole.levels, around, widened(piece.box, around.shape))
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
        search.found.append(ShadedArea(shade, piece.mask))
        return
    shade, rim, inwards = fading
    t = shade.t(wider.x, wider.y)
    own = known & ((t < rim) if inwards else (t > rim))
    search.found.append(ShadedArea(shade, wider.within(own), ink, rim, inwards))


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
    search.found.append(ShadedArea(shade, part.within(known)))
    for piece in part.pieces(~known):
        _explain(piece, search, depth + 1)
