"""Outlines of the parts of layers: beneath upper layers they continue in the simplest way that stays hidden.

The ways in which a hidden run of a contour may go on are tried from the simplest to the longest, in all runs at once. A
way is good if the outline covers all visible pixels of the part and none of lower layers.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from functools import cache, partial
from itertools import chain, groupby, islice, product
from operator import itemgetter

import numpy as np

from cubicsplat_cli.artwork.geometry.fitting import dot_of, few_lines, fit_outlines
from cubicsplat_cli.artwork.geometry.outlines import EXACT, Outline, Rectangle, Ring, level_box, polygon, turn_matrix
from cubicsplat_cli.artwork.layers.extents import Contour, Extent, Window, enclosed
from cubicsplat_cli.artwork.layers.ways import ALLOWED, DEPTHS, SLACK, Completion, HiddenLoop, sides_meeting, ways_on
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage

SEVERAL = 8  # hidden runs of a contour, beyond which only straight lines are tried, lest the trials are too many
SIDE_SEEN = 1.5  # px within which points show a side of a rounded rectangle, and of points that show one of a box
ON_SIDE = 0.25  # px by which a point may differ from the side of a box
LEAST_BOX = 3.0  # px across, of which one shows no edge
FLUSH = 0.6  # px that a side goes beneath what hides it at least: more than half a pixel, a corner less (0.6^2)
DOT = 4  # px of a region, up to which it is a dot; visible points of a contour, below which it becomes a polygon
MOST_WRONG = 20  # px of the picture that an outline may enclose or leave wrongly, before a plainer one replaces it
BATCH = 20_000  # points of contours that are fitted together: a second's work, after which it may be stopped

# Finds an outline; on the way it has others fitted to points with standard errors, and corners where some are known.
_Points = tuple[np.ndarray, np.ndarray, np.ndarray | None]
_Search = Generator[_Points, Outline, Outline]


def outlines_of(extent: Extent, canvas: tuple[int, int], detail: float) -> tuple[Outline, ...]:
    """The fitted outlines of a part of a layer, the outer one first: see `outlines_of_all`."""
    return next(outlines_of_all([extent], canvas, detail, whole=True, sought=True))


def outlines_of_all(
    extents: Sequence[Extent], canvas: tuple[int, int], detail: float, whole: bool, sought: bool, steps: int = 1
) -> Iterator[tuple[Outline, ...]]:
    """The fitted outlines of each of some parts of layers, the outer one first.

    canvas: its height and width, px. Contours of few points become polygons. whole: hidden parts go on as
    what shows suggests, rather than end as shortly as they may. sought: they do either, rather than run along their
    contour, a few px beneath what hides them. steps: px a pixel of the picture each way. Where a part likely ends at
    what hides it, it goes on beneath only if its outlines have fewer coordinates then.
    """
    ends = np.cumsum([sum(len(contour.points) for contour in extent.contours) for extent in extents])
    for _, batch in groupby(zip((ends // BATCH).tolist(), extents, strict=True), key=itemgetter(0)):
        some = [extent for _, extent in batch]
        searches: list[_Search] = []
        tried = [[extent] if extent.near is None else [extent.near, extent] for extent in some]
        for extent in chain.from_iterable(tried):
            window = cache(partial(Window.of, extent, canvas))  # which only hidden contours need to know
            searches += [_outline(own, extent, window, whole, sought, MOST_WRONG * steps**2) for own in extent.contours]
        found = iter(_searched(searches, detail))
        for either in tried:
            ways = [tuple(islice(found, len(extent.contours))) for extent in either]
            yield min(ways, key=lambda way: sum(outline.coordinates for outline in way))


def _searched(searches: Sequence[_Search], detail: float) -> list[Outline]:
    """Return the result of each search. The next fits of all searches are done together, on all threads."""
    found: dict[int, Outline] = {}
    answers: dict[int, Outline | None] = dict.fromkeys(range(len(searches)))
    while answers:
        work().at()
        asked = {}
        for number, answer in answers.items():
            try:
                search = searches[number]
                asked[number] = next(search) if answer is None else search.send(answer)
            except StopIteration as end:
                found[number] = end.value
        points, sigmas, corners = zip(*asked.values(), strict=True) if asked else ((), (), ())
        answers = dict(zip(asked, fit_outlines(points, sigmas, detail, corners), strict=True))
    return [found[number] for number in range(len(searches))]


def _outline(
    contour: Contour, extent: Extent, window: Callable[[], Window], whole: bool, sought: bool, astray: int
) -> _Search:
    """The outline of a contour of an extent; window: of that, and astray: see `_completed`."""
    points, seen = contour.points, np.isfinite(contour.sigma).all()
    if seen and len(points) <= 2 * DOT and not contour.hole and int(extent.shown.sum()) <= DOT:
        return dot_of(points, extent.shown, (extent.left, extent.top))
    if len(points) < 2 * DOT:
        return few_lines(points)
    if seen or not sought:
        return (yield points, contour.known, None)
    return (yield from _completed(contour, window(), whole, astray))


def _completed(contour: Contour, window: Window, whole: bool, astray: int) -> _Search:
    """window: that of the outer contour; astray: pixels of it from which an outline is wrong everywhere."""
    runs, outer = hidden_runs(contour.sigma), window
    window = outer.hole(contour) if contour.hole else outer
    if whole and not contour.hole and (box := _box(contour, window)) is not None:
        return box
    if np.isfinite(contour.sigma).sum() < DOT:
        return few_lines(contour.points, SLACK)
    loop = HiddenLoop(contour.points, contour.sigma, lambda points: len(window.wrong(polygon(points))), outer)
    whole = whole and len(runs) <= SEVERAL
    left = [ways_on(loop, run, whole) for run in runs]
    ways = [next(each) for each in left]
    open_runs = np.ones(len(runs), dtype=bool)
    best, least = None, np.inf
    for _ in range(24):  # trials
        outline = yield _guided(contour, runs, ways)
        bad = window.wrong(outline)
        count = len(bad) + (0 if _every_side_shows(contour, outline) else contour.points.size)
        if count < least:
            best, least = outline, count
        if count <= ALLOWED:
            break
        for k in _blamed(contour.points, runs, open_runs, bad):
            following = next(left[k], None)
            open_runs[k] = following is not None
            ways[k] = following or ways[k]
        if not open_runs.any():
            break
    assert best is not None
    if least > astray:
        # No way is hidden all along, or the fit has gone far astray: what is hidden ends where it does for certain.
        certain = yield contour.points, contour.known, np.zeros(len(contour.points), dtype=bool)
        for outline in (certain, few_lines(contour.points)):
            if (count := len(window.wrong(outline))) < least:
                best, least = outline, count
    if isinstance(best, Ring):
        best = level_box(best, EXACT) or best
    if isinstance(best, Ring) and whole and least <= ALLOWED:
        return (yield from _with_corners(best, contour, runs, ways, loop, window))
    return best


def _box(contour: Contour, window: Window) -> Rectangle | None:
    """The level box of which all that shows of an outer contour is sides, and whose others are hidden: at the canvas's
    border if they all may be there, else DEPTHS beneath what hides them, or some FLUSH; None where there is none.
    """
    shown = window.extent.shown
    rows, columns = ndimage.find_objects(shown)[0]
    corner = np.array([window.extent.left, window.extent.top], dtype=float)
    own = np.array([[columns.start, rows.start], [columns.stop, rows.stop]]) + corner
    seen, sides, hidden = contour.points[np.isfinite(contour.sigma)], own.copy(), np.ones((2, 2), dtype=bool)
    if len(seen):
        ends = np.stack([seen.min(axis=0), seen.max(axis=0)])
        on = (np.abs(seen[:, None] - ends) <= ON_SIDE) & (np.abs(ends - own) < 1.0)
        if not on.any(axis=(1, 2)).all():
            return None
        for end, axis in np.ndindex(2, 2):
            side = seen[on[:, end, axis] & ~on[:, :, 1 - axis].any(axis=1)]
            hidden[end, axis] = len(side) == 0 or np.ptp(side[:, 1 - axis]) <= SIDE_SEEN
            if not hidden[end, axis]:
                sides[end, axis] = side[:, axis].mean()
    size = np.ptp(own, axis=0)
    if hidden.sum() > 2 and (size.min() < LEAST_BOX or (shown | ndimage.holes_of(shown)).sum() < size.prod()):
        return None  # of fewer than two sides only what fills a box is known to be one
    border, outwards = np.array([[[0.0, 0.0], window.canvas[::-1]], [[-1.0, -1.0], [1.0, 1.0]]])[:, hidden]
    # Each of the hidden sides at a depth or flush, all of them flush once.
    depths = dict.fromkeys(chain.from_iterable(product((depth, FLUSH), repeat=len(outwards)) for depth in DEPTHS))
    for place in (border, *(sides[hidden] + outwards * each for each in depths)):
        sides[hidden] = place
        box = Rectangle(*sides[0].tolist(), *np.ptp(sides, axis=0).tolist())
        if len(window.wrong(box)) <= ALLOWED and not _shows_beyond(box, own, window.extent):
            return box
        if not hidden.any():
            break
    return None


def _shows_beyond(box: Rectangle, ends: np.ndarray, extent: Extent) -> bool:
    """True if a box would show beyond the ends (2, 2), low and high, of what shows, as beyond a thin line."""
    (rows, columns), own = enclosed(box.ring(), extent)
    places = (np.arange(columns.start, columns.stop) + extent.left, np.arange(rows.start, rows.stop) + extent.top)
    right, down = ((each + 0.5 < low) | (each + 0.5 > high) for each, low, high in zip(places, *ends, strict=True))
    hidden = (extent.allowed | extent.holes)[rows, columns]
    return bool((own & (down[:, None] | right) & ~hidden).any())


def _with_corners(
    found: Ring, contour: Contour, runs: list[np.ndarray], ways: list[Completion], loop: HiddenLoop, window: Window
) -> _Search:
    """The outline with hidden corners where straight sides meet, if that is shorter and hidden as well."""
    meeting = [None if len(way.corners) else sides_meeting(loop, run) for run, way in zip(runs, ways, strict=True)]
    if not any(meeting):
        return found
    ways = [other or way for other, way in zip(meeting, ways, strict=True)]
    outline = yield _guided(contour, runs, ways)
    good = outline.coordinates <= found.coordinates and len(window.wrong(outline)) <= ALLOWED
    return outline if good else found


def _every_side_shows(contour: Contour, outline: Outline) -> bool:
    """Return whether something of each side of a rectangle with round corners shows: hidden ones might be anywhere."""
    if not isinstance(outline, Rectangle) or outline.radius <= 0.0:
        return True
    half = 0.5 * np.array([outline.width, outline.height])
    offset = contour.points[np.isfinite(contour.sigma)] - half - np.array([outline.x, outline.y])
    local = offset @ turn_matrix(outline.angle).T
    return bool(((half - local).min(axis=0) < SIDE_SEEN).all() and ((half + local).min(axis=0) < SIDE_SEEN).all())


def hidden_runs(sigma: np.ndarray) -> list[np.ndarray]:
    """The indices of every run of hidden points of a closed contour, each in order."""
    hidden, index = ~np.isfinite(sigma), np.arange(len(sigma))
    if hidden.all():
        return [index]
    index = np.roll(index, -int(hidden.argmin()))  # from a point that shows
    runs = np.split(index, np.flatnonzero(np.diff(hidden[index])) + 1)[1::2]
    return sorted(runs, key=lambda run: int(run[0]))


def _guided(contour: Contour, runs: list[np.ndarray], ways: list[Completion]) -> _Points:
    """Points, standard errors, and which points are corners, with every hidden run guided in its way."""
    points, sigma, corners = contour.points.copy(), contour.sigma.copy(), np.zeros(len(contour.points), dtype=bool)
    for run, way in zip(runs, ways, strict=True):
        points[run], sigma[run], corners[run[way.corners]] = way.points, way.sigma, True
    return points, sigma, corners


def _blamed(points: np.ndarray, runs: list[np.ndarray], left: np.ndarray, wrong: np.ndarray) -> np.ndarray:
    """The runs nearest to wrong pixels that have another way left; all such runs where those have none."""
    if not len(wrong):
        return np.nonzero(left)[0]
    sample = wrong[:: max(1, len(wrong) // 50)]
    gaps = np.stack([np.hypot(*(points[run][None] - sample[:, None]).transpose(2, 0, 1)).min(axis=1) for run in runs])
    named = np.unique(gaps.argmin(axis=0))
    named = named[left[named]]
    return named if len(named) else np.nonzero(left)[0]
