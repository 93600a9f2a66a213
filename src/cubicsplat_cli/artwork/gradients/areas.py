"""The gradients that the even parts of a picture follow.

An area that no single gradient explains is divided: what has one colour is left to the fills, and each part of the rest
is looked at by itself.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.artwork.gradients.parts import CLEAR, LEAST_AREA, LEAST_PLATEAU, RING, Part, Patch, part_of, plateau
from cubicsplat_cli.artwork.gradients.shade import CLOSE, Shade, ShadedArea
from cubicsplat_cli.artwork.gradients.shades import shade_of
from cubicsplat_cli.artwork.gradients.uniting import EXPLAINED, united
from cubicsplat_cli.progress import log, work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels, part_spreads

LEAST_RANGE = 3.0  # levels, within which an area has one colour
NEARLY = 8.0  # levels by which a few pixels that make no area of their own may be off
MOST_PARTS, MOST_TRIES = 1000, 800  # uneven parts of a picture, and gradients sought, some hundredths of a second each
MOST_HINTS = 3
DEEPEST, SEEDS, LEAST_SHARE = 2, 3, 0.3


def gradient_areas(
    levels: np.ndarray, parts: np.ndarray, count: int, tries: int = MOST_TRIES, most: int = MOST_PARTS
) -> list[ShadedArea]:
    """The gradients of a picture (H, W, 4), premultiplied levels, the largest first.

    None in flat pictures, and in those of more than `most` uneven parts, which are photos or textures. tries: how
    often a gradient is sought, after which what is left stays as it is. Where the bounds are not the caller's own, that
    is logged.
    """
    sizes, boxes, spreads = part_spreads(levels, parts, count)
    uneven = np.flatnonzero((sizes >= LEAST_AREA) & (spreads > LEAST_RANGE))
    if len(uneven) > most:
        if most == MOST_PARTS:
            log.warning("%d areas of uneven colour are too many: they are drawn without gradients", len(uneven))
        return []
    search = _Search([], tries)
    for i in uneven[np.argsort(-sizes[uneven], kind="stable")]:
        work().at()
        _explain(part_of(levels, parts, i + 1, boxes[i]), search, 0)
    if search.left == 0 and tries == MOST_TRIES:
        log.warning("the smallest of %d areas of uneven colour are drawn without gradients", len(uneven))
    return united(levels, parts, boxes, search.found) if search.found else []


@dataclass(eq=False)
class _Search:
    """The gradients found so far, and how often one may still be sought."""

    found: list[ShadedArea]
    left: int

    def shade(self, pixels: Pixels) -> Shade | None:
        """The gradient of pixels; None where none may be sought any more."""
        if self.left <= 0:
            return None
        self.left -= 1
        radial = [shade for shade in {id(a.shade): a.shade for a in self.found}.values() if shade.radial]
        return shade_of(pixels, radial[-MOST_HINTS:])


def _explain(part: Part, search: _Search, depth: int) -> None:
    """Adds the gradients of a part to those found."""
    if len(part) < LEAST_AREA or part.range() <= LEAST_RANGE or depth > DEEPEST:
        return
    fill, even = plateau(part)
    clear = fill[3] <= CLEAR and even.any()
    if not clear:
        shade = search.shade(part.pixels)
        if shade is None:
            return
        off = shade.off(part.pixels)
        if (off <= CLOSE).mean() >= EXPLAINED:
            search.found.append(ShadedArea(shade, _with_rests(part, off)))
            return
    if clear or even.mean() >= LEAST_PLATEAU:
        for piece in part.pieces(~even):
            _fading(part, piece, fill, search, depth)
        return
    _largest(part, search, depth)


def _with_rests(part: Part, off: np.ndarray) -> Patch:
    """The pixels that a gradient explains, and the few that it nearly does. off: (n,) levels that they are off it."""
    own = part.within(off <= CLOSE)
    labels, count = ndimage.label(part.within((off > CLOSE) & (off <= NEARLY)).mask)
    few = np.bincount(labels.ravel(), minlength=count + 1) < LEAST_AREA
    few[0] = False
    return replace(own, mask=own.mask | few[labels])


def _fading(whole: Part, piece: Part, fill: np.ndarray, search: _Search, depth: int) -> None:
    """Adds the gradient of a piece of a part that fades into the fill beside it, or else those within the piece."""
    if len(piece) < LEAST_AREA or piece.range() <= LEAST_RANGE:
        return
    around = piece.patch.grown(RING, whole.levels.shape)
    rows, columns = around.places()
    own = whole.patch.at(rows, columns)
    around.mask[rows[~own] - around.top, columns[~own] - around.left] = False
    wider = Part(whole.levels, around)
    shade = search.shade(wider.pixels)
    if shade is None:
        return
    known = shade.explains(wider.pixels)
    if known.mean() < EXPLAINED:
        if len(piece) < 0.9 * len(whole):
            _explain(piece, search, depth + 1)
        else:
            _largest(piece, search, depth)
        return
    fading = _faded(shade, fill)
    if fading is None:
        search.found.append(ShadedArea(shade, piece.patch))
        return
    shade, rim, inwards = fading
    t = shade.t(wider.pixels.x, wider.pixels.y)
    own = known & ((t < rim) if inwards else (t > rim))
    search.found.append(ShadedArea(shade, wider.within(own), fill, rim, inwards))


def _faded(shade: Shade, fill: np.ndarray) -> tuple[Shade, float, bool] | None:
    """The shade with its end that has about the fill made exactly that, its t there, and whether the rest is below."""
    colours, knots = shade.ramp.colours.copy(), shade.ramp.knots
    gaps = [float(np.abs(colours[end] - fill).max()) for end in (0, -1)]
    if min(gaps) > CLOSE:
        return None
    last = gaps[1] < gaps[0]
    colours[-1 if last else 0] = fill
    ramp = type(shade.ramp)(knots, colours)
    return Shade(shade.frame, shade.radial, ramp, shade.parameters), float(knots[-1 if last else 0]), last


def _largest(part: Part, search: _Search, depth: int) -> None:
    """Adds the gradient that explains most of a part, of those of SEEDS places in it, and those of the rest."""
    reach = 0.5 * np.sqrt(len(part) / 3.0)
    picks = np.linspace(0, len(part) - 1, SEEDS + 2).astype(int)[1:-1]
    best: tuple[Shade, np.ndarray] | None = None
    most = LEAST_SHARE * len(part)
    x, y, _ = part.pixels
    for pick in picks:
        near = np.flatnonzero(np.maximum(np.abs(x - x[pick]), np.abs(y - y[pick])) <= reach)
        if len(near) < LEAST_AREA:
            continue
        shade = search.shade(part.pixels.some(near))
        if shade is None:
            break
        off = shade.off(part.pixels)
        if (explained := (off <= CLOSE).sum()) > most:
            best, most = (shade, off), float(explained)
    if best is None:
        return
    shade, off = best
    again = search.shade(part.pixels.some(off <= CLOSE))
    if again is None:
        return
    # That of all these pixels may have found another geometry, which explains fewer.
    if ((other := again.off(part.pixels)) <= CLOSE).sum() >= most:
        shade, off = again, other
    search.found.append(ShadedArea(shade, _with_rests(part, off)))
    for piece in part.pieces(off > CLOSE):
        _explain(piece, search, depth + 1)
