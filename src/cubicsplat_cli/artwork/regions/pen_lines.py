"""Lines of one pen that lie between pixels, where each row of pixels shows a part of their ink.

That level and upright lines of one fill are another fill's is told by lines elsewhere that are as wide, or by what
shows where two of them cross.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import blend_of, largest
from cubicsplat_cli.artwork.regions.fills import APART, LONG, SAME, SEEN, TOGETHER, has_square
from cubicsplat_cli.artwork.regions.hairlines import long_parts
from cubicsplat_cli.artwork.regions.hidden_fills import BESIDE_GROUND, FLAT, LEAST_SHARE, MORE, NEAR
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.unmix import line_sections
from cubicsplat_cli.record import record

NARROWEST, WIDEST = 0.75, 2.0  # px of a line across that shows its fill in some places, but not in all
# px by which lines of one width differ: one of the four samples across a pixel that many programs take, or else what
# rounding leaves. QUARTERS: of a pixel, in quarters, by which a share is off what samples give.
SAMPLE, EXACT, QUARTERS = 0.25, 0.07, 0.12
# Of the angle at which two lines through colours meet. The rounding of these, of about a level with what is between,
# leaves 1 / sine of it where they do.
LEAST_SINE = 0.06
FAINT, WHOLE = 0.02, 0.95  # shares of a line in a pixel that belongs to it, and in one that is its own


def pen_blends(
    levels: np.ndarray, palette: np.ndarray, pure: np.ndarray, flat: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the fills (k, 4) that only the crossings of lines tell (`crossing_ink`), and (P,) bool: True for fills of
    a palette (P, 4) in levels that lines of another fill leave where they lie between pixels: they are as wide as other
    lines, of which pixels show more; and for fills where such lines cross.

    Other parameters as of `hidden_fills.line_blends`.
    """
    counts, interior = (np.bincount(pure[where & (pure >= 0)], minlength=len(palette)) for where in (True, flat))
    doubtful = interior <= FLAT
    thin = doubtful & (counts >= LONG)
    if not thin.any() or doubtful.all():
        return palette[:0], np.zeros(len(palette), dtype=bool)
    solid, out = palette[~doubtful], np.zeros(len(palette), dtype=bool)

    def between(ink: np.ndarray, least: float = LEAST_SHARE) -> np.ndarray:
        """(P,) bool: doubtful fills that blend it with an area's, and have a share of it."""
        share, rest = blend_of(palette, solid[:, None], ink)
        good = (share >= least) & (share < 1.0) & (largest(np.abs(rest)) <= SEEN)
        return doubtful & ~out & good.any(axis=0)

    def drop(found: np.ndarray, blends: np.ndarray) -> None:
        """Call fills (P,) bool false, and those that blend the same line only near them."""
        near = ndimage.maximum_filter(np.append(found, False)[pure], NEAR) & (pure >= 0)
        out[found | blends & (np.bincount(pure[near], minlength=len(palette)) >= BESIDE_GROUND * counts)] = True

    inks = list[np.ndarray]()

    def add(ink: np.ndarray, lines: list[int], off: float = SEEN) -> None:
        """Take an ink, told to some levels, or the like of it that is known, for lines of these fills."""
        known = np.vstack([palette[~out], *inks])
        gaps = largest(np.abs(known - ink))
        if gaps.min() > off:
            inks.append(ink)
        else:
            ink = known[gaps.argmin()]
        # What has nearly all of it are slanted lines of the same pen.
        drop(between(ink, 1.0 - MORE) | np.isin(np.arange(len(palette)), lines), between(ink))

    for ink, off, lines in border_inks(palette, pure, thin, ~doubtful):
        if not out[lines].all():
            add(ink, lines, off)
    for k in np.flatnonzero(thin).tolist():
        crossed = None if out[k] else crossing_ink(levels, palette[k], solid, pure == k)
        if crossed is not None:
            add(crossed, [k])
    areas = np.where((pure < 0) | doubtful[pure], -1, pure)
    # A false fill lies between the line's and an area's, so that the farthest from the areas is tried first.
    contrast = largest(np.abs(palette[:, None] - solid)).min(axis=1)
    for line in np.argsort(-contrast, kind="stable"):
        blends = between(palette[line])
        if out[line] or not counts[line] or not (blends & thin).any():
            continue
        pen = _pen(levels, np.where(areas == line, -1, areas), palette, line)
        found = np.array([tried and pen.drew(pure == k) for k, tried in enumerate((blends & thin).tolist())])
        if found.any():
            drop(found, blends)
    return np.array(inks).reshape(-1, 4), out


def border_inks(
    palette: np.ndarray, pure: np.ndarray, thin: np.ndarray, solid: np.ndarray
) -> list[tuple[np.ndarray, float, list[int]]]:
    """Return the fills (4,) of lines that lie between two rows of pixels and two areas of different fills, each with
    the levels to which it is told and the numbers of the fills that such lines leave: each row blends the line with the
    area beside it, and only one colour is in line with both.

    palette: (P, 4) levels; pure: (H, W) the fills of pixels, -1 for none; thin, solid: (P,) bool, fills of lines and of
    areas.
    """
    found = list[np.ndarray]()
    for rows in (pure, pure.T):
        one, first, second, other = (rows[:, k : rows.shape[1] - 3 + k] for k in range(4))
        told = (first >= 0) & (second >= 0) & (one >= 0) & (other >= 0) & (one != other) & (first != second)
        told &= thin[first] & thin[second] & solid[one] & solid[other]
        found.append(np.stack([one[told], first[told], second[told], other[told]], axis=1))
    lines = np.concatenate(found)
    lines = np.where(lines[:, :1] > lines[:, 3:], lines[:, ::-1], lines)
    kinds, counts = np.unique(lines, axis=0, return_counts=True)
    areas, rows = palette[kinds[:, [0, 3]]], palette[kinds[:, 1:3]]
    # The shares are where two lines, each from an area through the row beside it, are nearest to each other.
    ways, apart = rows - areas, areas[:, 1] - areas[:, 0]
    squares, between = (ways**2).sum(axis=2), (ways[:, 0] * ways[:, 1]).sum(axis=1)
    along = (ways * apart[:, None]).sum(axis=2)
    turn = squares.prod(axis=1) - between**2
    times = (along * squares[:, ::-1] - along[:, ::-1] * between[:, None]) * [1.0, -1.0]
    times /= np.maximum(turn, 1.0)[:, None]
    inks = areas + times[..., None] * ways
    ink = np.clip(inks.mean(axis=1), 0.0, 255.0)
    widths = (1.0 / np.maximum(times, 1.0)).sum(axis=1)
    good = (counts >= TOGETHER) & (times >= 1.0).all(axis=1) & (widths >= NARROWEST) & (widths <= WIDEST)
    sines = np.sqrt(np.maximum(turn, 0.0) / np.maximum(squares.prod(axis=1), 1.0))
    good &= sines > LEAST_SINE
    good &= (np.abs(inks - ink[:, None]) <= SAME * times[..., None]).all(axis=(1, 2))
    good &= (np.abs(rows - ink[:, None]).max(axis=2) > APART).all(axis=1)
    out, left = list[tuple[np.ndarray, float, list[int]]](), np.where(good, sines, 0.0)
    while left.max(initial=0.0):
        best, known = int(left.argmax()), np.maximum(SEEN, 1.0 / np.maximum(left, LEAST_SINE))
        same = (left > 0.0) & (largest(np.abs(ink - ink[best])) <= known)
        if counts[same].sum() >= LONG:
            told = _where_lines_meet(areas[same], ways[same], counts[same, None] / times[same] ** 2)
            out.append((np.clip(told, 0.0, 255.0), float(known[best]), np.unique(kinds[same, 1:3]).tolist()))
        left[same] = 0.0
    return out


def _where_lines_meet(starts: np.ndarray, ways: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """Return the place (4,) nearest to lines from starts (..., 4) in directions (..., 4), by weights (...)."""
    units = ways / np.linalg.norm(ways, axis=-1, keepdims=True)
    across = weights[..., None, None] * (np.eye(4) - units[..., :, None] * units[..., None, :])
    sums = across.reshape(-1, 4, 4).sum(axis=0), (across @ starts[..., None]).reshape(-1, 4).sum(axis=0)
    return np.linalg.lstsq(*sums, rcond=None)[0]


def crossing_ink(levels: np.ndarray, fill: np.ndarray, grounds: np.ndarray, shown: np.ndarray) -> np.ndarray | None:
    """Return the fill (4,) of lines between two rows of pixels, of which each has a share s, by what shows where they
    meet: 1 - (1 - s)^2 of it, or 2 - s times as much; None if nothing tells. Lines of their own fill show no more.

    fill: (4,) levels, what these lines leave; grounds: (G, 4), one of which is beside them; shown: (H, W) bool, where.
    """
    if has_square(shown.astype(np.int32) - 1)[shown].mean() < BESIDE_GROUND:
        return None
    beside, above = (ndimage.maximum_filter(shown, size) for size in ((1, 3), (3, 1)))
    meeting = levels[beside & above & ~shown]
    for ground in grounds:
        share, rest = blend_of(meeting, ground, fill, most=None)
        more = share[(largest(np.abs(rest)) <= SEEN) & (share > 1.0)]
        if len(more) < TOGETHER or np.ptp(np.quantile(more, [0.1, 0.9])) > 2.0 * FAINT:
            continue
        own = 2.0 - float(np.median(more))
        ink = ground + (fill - ground) / max(own, LEAST_SHARE)
        if own < 0.5 * NARROWEST or np.abs(ink - fill).max() <= APART:
            continue
        if (np.abs(ink - np.clip(ink, 0.0, 255.0)) <= SAME).all():
            return np.clip(ink, 0.0, 255.0)
    return None


@record
class _Pen:
    """The lines in a fill between areas. shares: (H, W) theirs of each pixel. widths: (H, W) px of the line at a pixel,
    infinite where none is told. (H, W) bool: long, of lines of LONG px; level, of level and upright lines between rows
    of pixels; slanted, of all others that fill no whole pixels.
    """

    shares: np.ndarray
    widths: np.ndarray
    long: np.ndarray
    level: np.ndarray
    slanted: np.ndarray

    def drew(self, shown: np.ndarray) -> bool:
        """Return True if pixels (H, W) bool are of lines as wide as LONG px of others, and LONG px show more of the
        fill.

        In a design of whole pixels level lines of a fill of their own may look alike, but all of them have one share,
        and more shows nowhere beside them, as it does where lines meet.
        """
        widths, share = self.widths[shown], float(self.shares[shown].mean())
        told = (widths >= NARROWEST) & (widths <= WIDEST)
        if told.mean() < BESIDE_GROUND:
            return False
        off = np.abs(self.widths - widths[told].mean())
        sampled = self.slanted | (_in_quarters(self.shares) & _in_quarters(share))
        elsewhere = self.long & ~ndimage.maximum_filter(shown, NEAR)
        others = elsewhere & (off <= np.where(sampled, SAMPLE, EXACT))
        more = self.shares > min(share + MORE, 0.5 + 0.5 * share)
        if (off[shown] <= SAMPLE).mean() < BESIDE_GROUND or (others & more).sum() < LONG:
            return False
        meeting = ndimage.maximum_filter(shown & self.level, NEAR) & more & ~shown & (self.shares < 1.0)
        slanted = (others & self.slanted).sum() >= LONG and meeting.sum() >= TOGETHER
        return bool(slanted or (others & self.level).sum() >= LONG)


def _in_quarters(share: np.ndarray | float) -> np.ndarray:
    """Return bool: True for shares that four samples across a pixel leave of level lines."""
    return np.abs(4.0 * share - np.rint(4.0 * share)) <= QUARTERS


def _pen(levels: np.ndarray, areas: np.ndarray, palette: np.ndarray, line: int) -> _Pen:
    """Return the lines in a fill of a palette (P, 4) between areas of others, (H, W) as of `line_sections`, in a
    picture (H, W, 4).
    """
    shares, across, down, whole = line_sections(levels, areas, palette, palette[line], SEEN, WHOLE)
    across, down = (np.where(each > 0.0, each, np.inf) for each in (across, down))
    with np.errstate(divide="ignore"):
        widths = 1.0 / np.hypot(1.0 / across, 1.0 / down)
    level = np.maximum(across, down) >= LONG
    between = ~whole & (shares < WHOLE * widths)  # hardly any thinner line lies within one row
    drawn = shares > FAINT
    return _Pen(shares, widths, long_parts(drawn, drawn, LONG), level & between, ~level & ~whole)
