"""Estimate the inks of thin lines on paper, and the blur through which they are seen.

Across a line of width w in an ink of depth D, seen through a Gaussian of standard deviation s, the depth is that of a
box convolved with the Gaussian. Its integral is D w, its variance w^2/12 + s^2, and its fourth cumulant, -D w^5/120,
tells width and blur apart. Depths and widths are fitted to the mean profiles of lines of about one mass and tint, with
one blur for all, by least squares.

Profiles are taken across the middle of lines that are alone. The result gives the share of each pixel that the ink of
a pen covered before it was blurred.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import LUMA
from cubicsplat_cli.artwork.input.chroma import SNAP
from cubicsplat_cli.artwork.input.condition import OUTLIER
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

REACH, STEP = 8.0, 0.5  # px to either side of a line, and between the samples of a profile
OFFSETS = np.arange(-REACH, REACH + 0.5 * STEP, STEP)  # px across a line, of the samples
TINT = 0.25  # difference of tints (channels over luma) within which they are one
FEWEST = 80  # places of a kind of line


@record
class Profiles:
    """places: (n, 2) x and y, px, on lines. depths: (n, u) levels darker than paper at OFFSETS (u,). masses: (n,)
    integrals of the depth across, levels px; tints: (n, 3) those of the channels over that; both are means of the
    places around.
    """

    places: np.ndarray
    depths: np.ndarray
    masses: np.ndarray
    tints: np.ndarray


def profiles_of(dark: np.ndarray, least: float) -> Profiles:
    """Return the profiles across all lines that are alone within REACH, with six or more others within 8 px.

    dark: (H, W, 3) levels by which a picture is darker than its paper; least: levels of depth that a line has,
    and by which the mean of the outermost 3 samples of a profile may be off the paper.
    """
    depth = dark @ LUMA
    places, directions = _ridges(depth, least)
    depths = _sampled(depth, places, directions)
    outer = np.concatenate([depths[:, :3], depths[:, -3:]], axis=1).reshape(-1, 2, 3).mean(axis=2)
    alone = (np.abs(outer) <= least).all(axis=1)
    places, directions, depths = places[alone], directions[alone], depths[alone]
    near = PointTree(places).query_ball_point(places, 8.0)
    many = np.array([len(part) >= 6 for part in near], dtype=bool)
    own = np.stack([_sampled(dark[..., k], places, directions).sum(axis=1) * STEP for k in range(3)], axis=-1)
    masses = np.array([own[part].mean(axis=0) for part in near]).reshape(-1, 3)[many]
    total = masses @ LUMA
    return Profiles(places[many], depths[many], total, masses / np.maximum(total, 1e-6)[:, None])


def _ridges(depth: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Return places (n, 2) on the middle of lines, to a part of a px, and unit directions (n, 2) across them: places at
    which the second derivatives of the smoothed depth have one large negative eigenvalue, and no slope in its direction
    (Steger 1998). Along a line the depth bends less than 0.15 of the bend across it, at least 0.04 of the depth.
    """
    from scipy import ndimage  # takes a while to import, and few pictures are scans

    orders = (0, 0), (0, 2), (2, 0), (1, 1), (0, 1), (1, 0)
    soft, xx, yy, xy, dx, dy = (ndimage.gaussian_filter(depth, 1.2, order=order) for order in orders)  # px
    mean, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    across, along = mean - half, mean + half
    turn = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
    direction = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    slope = dx * direction[..., 0] + dy * direction[..., 1]
    # Newton's step on the logarithm of the depth, which is a parabola where a profile is a Gaussian.
    shift = slope * soft / np.maximum(slope**2 - across * soft, 1e-6)
    line = (soft > least) & (across < -0.04 * soft) & (np.abs(along) < 0.15 * np.abs(across))
    line &= (np.abs(shift[..., None] * direction) <= 0.6).all(axis=-1)  # px; a line between two pixels is in both
    y, x = np.nonzero(line)
    return np.stack([x, y], axis=1) + shift[line][:, None] * direction[line], direction[line]


def _sampled(values: np.ndarray, places: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Return (n, u): values (H, W) at OFFSETS (u,) from places (n, 2) along directions (n, 2), by cubic splines."""
    from scipy import ndimage

    at = places[:, None] + OFFSETS[None, :, None] * directions[:, None]
    return ndimage.map_coordinates(values, [at[..., 1], at[..., 0]], order=3, mode="nearest")


@record
class Pens:
    """blur: standard deviation in px. paper: (3,) and inks: (k, 3), levels. places: (n, 2) px, on the middle of lines
    and in areas; owners: (n,) their inks; widths: (n,) px.
    """

    blur: float
    paper: np.ndarray
    inks: np.ndarray
    places: np.ndarray
    owners: np.ndarray
    widths: np.ndarray


def pens_of(bare: np.ndarray, paper: np.ndarray, grain: float) -> Pens | None:
    """Return the pens that drew on paper; None if too few lines are thin enough to tell. bare: (H, W, 3) levels under
    even light; paper: (3,) those of its paper but for the grain, a standard deviation in levels.
    """
    lines = profiles_of(paper - bare, OUTLIER * grain)
    kinds = _kinds(lines)
    own = kinds >= 0
    if not own.any():
        return None
    tints = np.array([np.median(lines.tints[kinds == k], axis=0) for k in range(kinds.max() + 1)])
    black = 1.0 / (tints / np.maximum(paper, 1.0)).max(axis=1)
    blur, depths, errors = _fitted(lines, kinds, black, grain)
    masses = np.array([np.median(lines.masses[kinds == k]) for k in range(len(tints))])
    owners, first = _inks(tints, depths, errors, masses, blur)
    inks = np.rint(np.clip(paper - depths[first][:, None] * tints[first], 0.0, 255.0))
    owner = owners[kinds[own]]
    widths = lines.masses[own] / ((paper - inks) @ LUMA)[owner]
    return _with_areas(Pens(blur, paper, inks, lines.places[own], owner, widths), bare, OUTLIER * grain)


def _with_areas(pens: Pens, bare: np.ndarray, least: float) -> Pens | None:
    """Return the pens with the inks of areas, three times as wide as the widest line and its blur, that are off all
    others by more than 40 levels; None if areas cover more than twice as much as lines. least: levels by which ink is
    darker than paper.
    """
    dark = ndimage.gaussian_filter((pens.paper - bare) @ LUMA, 1.0) > 2.0 * least
    wide = 3.0 * (float(np.quantile(pens.widths, 0.95)) + pens.blur) + 2.0
    deep = ndimage.distance_transform_edt(dark) > 0.5 * wide
    parts, count = ndimage.label(deep)
    if not count:
        return pens
    if deep.sum() > 2.0 * pens.widths.sum():
        return None
    inks, owners = list(pens.inks), np.full(count + 1, -1)
    for k, box in enumerate(ndimage.find_objects(parts), start=1):
        ink = np.rint(np.clip(np.median(bare[box][parts[box] == k], axis=0), 0.0, 255.0))
        gaps = [float(np.abs(ink - other).max()) for other in inks]
        owners[k] = int(np.argmin(gaps)) if min(gaps) <= 40.0 else len(inks)
        if owners[k] == len(inks):
            inks.append(ink)
    y, x = np.nonzero(deep)
    places = np.concatenate([pens.places, np.stack([x, y], axis=1)])
    owners, widths = np.append(pens.owners, owners[parts[y, x]]), np.append(pens.widths, np.full(len(y), wide))
    return Pens(pens.blur, pens.paper, np.array(inks), places, owners, widths)


def _kinds(lines: Profiles) -> np.ndarray:
    """Return (n,) the kind of each profile: lines of one tint and about one mass, by e^0.3; -1 for rare ones."""
    kinds = np.full(len(lines.masses), -1)
    free = lines.masses > 0.0
    size = np.log(np.maximum(lines.masses, 1e-6))
    count = 0
    while free.sum() >= FEWEST:
        middle = float(np.median(size[free]))
        first = np.flatnonzero(free)[np.abs(size[free] - middle).argmin()]
        own = free & (np.abs(size - size[first]) <= 0.3)
        own &= (np.abs(lines.tints - lines.tints[first]) <= TINT).all(axis=1)
        if own.sum() >= FEWEST:
            kinds[own] = count
            count += 1
        free &= ~own
    return kinds


def _fitted(
    lines: Profiles, kinds: np.ndarray, black: np.ndarray, grain: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """Return the blur, px, and for each kind of line the depth of its ink, in levels of luma, and its standard error.
    black: the depth of the darkest ink of its tint, in levels.

    Mean profiles are off by 0.3 levels whatever their number, and the grain is alike over 6 places of a line. Besides,
    the darkest channel of an ink is usually at 0.85 +- 0.15 of the depth of black, and lines are rarely thinner than
    1.2 px, by a standard deviation of 0.2.
    """
    # These take a while to import, and few pictures are scans.
    from scipy.optimize import least_squares
    from scipy.special import erf

    count = len(black)
    means = np.array([lines.depths[kinds == k].mean(axis=0) for k in range(count)])
    errors = np.array([np.hypot(grain * (6.0 / (kinds == k).sum()) ** 0.5, 0.3) for k in range(count)])

    def off(x: np.ndarray) -> np.ndarray:
        depths, widths, grounds = x[1:].reshape(3, count)
        soft = np.sqrt(2.0 * (x[0] ** 2 + 1.0 / 12.0))  # a pixel is a square
        u, half = OFFSETS / soft, 0.5 * widths[:, None] / soft
        drawn = grounds[:, None] + 0.5 * depths[:, None] * (erf(u + half) - erf(u - half))
        thin = np.maximum(1.2 - widths, 0.0) / 0.2
        return np.concatenate([((drawn - means) / errors[:, None]).ravel(), (depths / black - 0.85) / 0.15, thin])

    least, most = np.full(3 * count + 1, 1e-3), np.full(3 * count + 1, np.inf)
    most[0], most[1 : count + 1] = 3.0, black  # px, levels
    least[2 * count + 1 :] = -np.inf
    begin = np.concatenate([np.full(count, 0.8) * black, means.sum(axis=1) * STEP / (0.8 * black), np.zeros(count)])
    fit = least_squares(off, np.concatenate([[1.0], begin]), bounds=(least, most), x_scale="jac")
    variances = np.linalg.pinv(fit.jac.T @ fit.jac).diagonal()
    return float(fit.x[0]), fit.x[1 : count + 1], np.sqrt(variances[1 : count + 1])


def _inks(
    tints: np.ndarray, depths: np.ndarray, errors: np.ndarray, masses: np.ndarray, blur: float
) -> tuple[np.ndarray, list[int]]:
    """Return (kinds,) the ink of each kind, and for each ink the kind that tells it best. Kinds of one tint share an
    ink if their depths differ by at most 2.5 standard errors, or a quarter; or by a factor of 2, if the line that seems
    darker is thinner than 1.5 standard deviations of its blur, which hides its depth.
    """
    owners, first = np.full(len(depths), -1), list[int]()
    for kind in np.argsort(errors / depths, kind="stable").tolist():
        for number, other in enumerate(first):
            off = abs(depths[kind] - depths[other])
            near = off <= max(2.5 * float(np.hypot(errors[kind], errors[other])), 0.25 * depths[other])
            thin = masses[kind] < 1.5 * blur * depths[kind]
            near |= thin and depths[other] < depths[kind] < 2.0 * depths[other]
            if near and np.abs(tints[kind] - tints[other]).max() <= TINT:
                owners[kind] = number
                break
        else:
            owners[kind] = len(first)
            first.append(kind)
    return owners, first


def sharpened(levels: np.ndarray, pens: Pens) -> tuple[np.ndarray, np.ndarray]:
    """Return the drawing as sharp and even as its pens drew it, (H, W, 4) float32 in levels: paper, inks, and blends of
    paper and one ink; and the fills (k, 4), the paper's first. levels: (H, W, 4) the drawing, paper elsewhere.
    """
    owner = _owners(np.any(levels[..., :3] != pens.paper, axis=-1), pens)
    # A pale ink shows in those channels that it darkens.
    depths = pens.paper - pens.inks
    weights = depths * LUMA
    weights /= np.maximum((weights * depths).sum(axis=1, keepdims=True), 1e-6)
    share = ((pens.paper - levels[..., :3]) * weights[owner]).sum(axis=-1, dtype=np.float32)
    share = _unblurred(share, pens.blur)
    share = np.where(share < SNAP, 0.0, np.where(share > 1.0 - SNAP, 1.0, share))[..., None]
    out = np.full(levels.shape, 255.0, dtype=np.float32)
    out[..., :3] = pens.paper + share * (pens.inks[owner] - pens.paper)
    opaque = np.full((len(pens.inks) + 1, 1), 255.0)
    return out, np.hstack([np.vstack([pens.paper, pens.inks]), opaque])


def unexplained(levels: np.ndarray, pens: Pens, far: float) -> float:
    """Return the share of the pixels of ink, off the paper by `far` levels or more, that differ by as much from what
    the pens drew, blurred as they are. levels: (H, W, 4) the drawing, paper elsewhere.
    """
    sharp, _ = sharpened(levels, pens)
    off = [levels[..., k] - ndimage.gaussian_filter(sharp[..., k], pens.blur, truncate=3.0) for k in range(3)]
    ink = (np.abs(levels[..., :3] - pens.paper) >= far).any(axis=-1).sum()
    return float((np.abs(off) >= far).any(axis=0).sum()) / max(1, int(ink))


def _owners(drawn: np.ndarray, pens: Pens) -> np.ndarray:
    """Return (H, W): the ink of each drawn pixel, that of the nearest line relative to its width; 0 elsewhere."""
    out = np.zeros(drawn.shape, dtype=np.int64)
    y, x = np.nonzero(drawn)
    nearest = np.full(len(y), np.inf)
    for k in range(len(pens.inks)):
        own = pens.owners == k
        reach = 0.5 * float(np.median(pens.widths[own])) + 2.0 * pens.blur
        distance = PointTree(pens.places[own]).query(np.stack([x, y], axis=1))[0] / reach
        better = distance < nearest
        out[y[better], x[better]], nearest[better] = k, distance[better]
    return out


def _unblurred(share: np.ndarray, blur: float) -> np.ndarray:
    """Return the shares in 0..1 that look like these (H, W) through a Gaussian, by accelerated projected steps (Beck
    and Teboulle 2009): 20, since more would amplify the grain.
    """
    out = np.clip(share, 0.0, 1.0)
    ahead, pace = out, 1.0
    for _ in range(20):
        missing = share - ndimage.gaussian_filter(ahead, blur, truncate=3.0)
        new = np.clip(ahead + ndimage.gaussian_filter(missing, blur, truncate=3.0), 0.0, 1.0)
        following = 0.5 * (1.0 + (1.0 + 4.0 * pace**2) ** 0.5)
        ahead = new + (pace - 1.0) / following * (new - out)
        out, pace = new, following
    return out
