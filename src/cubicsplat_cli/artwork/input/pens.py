"""The inks of thin lines on paper, and the blur that they are seen through.

Across a line of width w in an ink of depth D, seen through a Gaussian of standard deviation s, the depth is that of a
box convolved with it. Its integral is D w, its variance w^2/12 + s^2, and its fourth cumulant, -D w^5/120, tells the
two apart. The means of all profiles of about one mass and tint tell it by least squares, with one blur for all.

Profiles are taken across the middle of lines that are alone. From what is found follows the share of each pixel that
the ink of a pen covered before it was blurred.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import LUMA
from cubicsplat_cli.artwork.input.paper import FAINT
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

SCALE = 1.2  # px, standard deviation of the Gaussian whose derivatives tell where lines run
# Along a line the depth bends less than a share of how it bends across it; and across by so much for its depth.
ALONG, ACROSS = 0.15, 0.04
NEAR = 0.6  # px from a pixel's middle to that of the line in it: both pixels beside one have it
REACH, STEP = 8.0, 0.5  # px to either side of a line, and between the samples of a profile
OUTER = 3  # samples at either end that hold nothing but paper beside a line that is alone
AROUND, FEWEST_AROUND = 8.0, 6  # px within which places belong together, and how many there must be
EVEN = 3.0  # standard deviations of the grain that profiles may be off the paper at their ends
# Tints, of channels over luma, and natural logarithms of masses, that differ by less are one.
TINT, MASS = 0.25, 0.3
FEWEST = 80  # places of a kind of line
# Grain is alike over so many places of a line; and levels by which a mean profile is off whatever the number.
ALIKE, ERROR = 6.0, 0.3
# Of an ink's darkest channel: how dark it usually is, of what black would be, and the standard deviation of that.
USUAL, SPREAD = 0.85, 0.15
THIN, THINNER = 1.2, 0.2  # px that lines are rarely narrower than, and the standard deviation of those that are
MOST_BLUR = 3.0  # px
SAME_FILL, SAME_SHARE = 2.5, 0.25  # standard errors, and share of the depth, within which two kinds have one ink
THINNEST, MOST_DARKER = 1.5, 2.0  # standard deviations of the blur, and times the depth
# An area is what is so many times as wide as the widest line and its blur. Levels by which its ink is none of those
# known, and the most that it may cover, as a share of what lines do.
WIDER, OTHER, MOST_AREA = 3.0, 40.0, 2.0
ROUNDS = 20
SNAP = 0.1  # shares this near to 0 or 1 are


@record
class Profiles:
    """places: (n, 2) x and y, px. depths: (n, u) levels darker than paper at `offsets` (u,) px across the line.
    masses: (n,) levels px that a line is darker by in all; tints: (n, 3) those of the channels over that. Both are
    means of the places around.
    """

    places: np.ndarray
    offsets: np.ndarray
    depths: np.ndarray
    masses: np.ndarray
    tints: np.ndarray


def profiles_of(dark: np.ndarray, least: float, even: float) -> Profiles:
    """The profiles across all lines that are alone within REACH.

    dark: (H, W, 3) levels by which a picture is darker than its paper; least: levels of depth that a line has;
    even: levels of what may be left of one at the ends of a profile.
    """
    depth = dark @ LUMA
    places, ways = _ridges(depth, least)
    offsets = np.arange(-REACH, REACH + 0.5 * STEP, STEP)
    depths = _sampled(depth, places, ways, offsets)
    outer = np.concatenate([depths[:, :OUTER], depths[:, -OUTER:]], axis=1).reshape(-1, 2, OUTER).mean(axis=2)
    alone = (np.abs(outer) <= even).all(axis=1)
    places, ways, depths = places[alone], ways[alone], depths[alone]
    near = PointTree(places).query_ball_point(places, AROUND) if len(places) else []
    many = np.array([len(own) >= FEWEST_AROUND for own in near], dtype=bool)
    own = np.stack([_sampled(dark[..., k], places, ways, offsets).sum(axis=1) * STEP for k in range(3)], axis=-1)
    masses = np.array([own[part].mean(axis=0) for part in near]).reshape(-1, 3)[many]
    total = masses @ LUMA
    return Profiles(places[many], offsets, depths[many], total, masses / np.maximum(total, 1e-6)[:, None])


def _ridges(depth: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Places (n, 2) on the middle of lines, to a part of a px, and unit ways (n, 2) across them: where the second
    derivatives of the smoothed depth have one large negative value and the slope in its direction is 0 (Steger 1998).
    """
    from scipy import ndimage  # takes a while to import, and few pictures are scans

    soft = ndimage.gaussian_filter(depth, SCALE)
    xx, yy, xy, dx, dy = (
        ndimage.gaussian_filter(depth, SCALE, order=order) for order in ((0, 2), (2, 0), (1, 1), (0, 1), (1, 0))
    )
    mean, half = 0.5 * (xx + yy), np.hypot(0.5 * (xx - yy), xy)
    across, along = mean - half, mean + half
    turn = 0.5 * np.arctan2(2.0 * xy, xx - yy) + 0.5 * np.pi
    way = np.stack([np.cos(turn), np.sin(turn)], axis=-1)
    slope = dx * way[..., 0] + dy * way[..., 1]
    # Newton's step on the logarithm of the depth, which is a parabola where a profile is a Gaussian.
    shift = slope * soft / np.maximum(slope**2 - across * soft, 1e-6)
    line = (soft > least) & (across < -ACROSS * soft) & (np.abs(along) < ALONG * np.abs(across))
    line &= (np.abs(shift[..., None] * way) <= NEAR).all(axis=-1)
    y, x = np.nonzero(line)
    return np.stack([x, y], axis=1) + shift[line][:, None] * way[line], way[line]


def _sampled(values: np.ndarray, places: np.ndarray, ways: np.ndarray, offsets: np.ndarray) -> np.ndarray:
    """(n, u) values (H, W) at offsets across places, by cubic splines."""
    at = places[:, None] + offsets[None, :, None] * ways[:, None]
    from scipy import ndimage

    return ndimage.map_coordinates(values, [at[..., 1], at[..., 0]], order=3, mode="nearest")


@record
class Pens:
    """blur: standard deviation in px. inks: (k, 3) levels on white paper. places: (n, 2) px, on the middle of lines
    and in areas; owners: (n,) their inks; widths: (n,) px.
    """

    blur: float
    inks: np.ndarray
    places: np.ndarray
    owners: np.ndarray
    widths: np.ndarray


def pens_of(bare: np.ndarray, grain: float) -> Pens | None:
    """The pens that drew on paper: bare, (H, W, 3) levels that the paper has 255 of but for its grain, of a standard
    deviation in levels. None where too few lines are thin enough to tell.
    """
    if min(bare.shape[:2]) < 2 * REACH:
        return None
    lines = profiles_of(255.0 - bare, FAINT * grain, EVEN * grain)
    kinds = _kinds(lines)
    if not (kinds >= 0).any():
        return None
    tints = np.array([np.median(lines.tints[kinds == k], axis=0) for k in range(kinds.max() + 1)])
    blur, depths, errors = _fitted(lines, kinds, tints, grain)
    masses = np.array([np.median(lines.masses[kinds == k]) for k in range(len(tints))])
    owners, inks = _inks(tints, depths, errors, masses, blur)
    own = kinds >= 0
    owner = owners[kinds[own]]
    widths = lines.masses[own] / ((255.0 - inks) @ LUMA)[owner]
    pens = Pens(blur, inks, lines.places[own], owner, widths)
    return _with_areas(pens, bare, FAINT * grain)


def _with_areas(pens: Pens, bare: np.ndarray, least: float) -> Pens | None:
    """The pens with the inks of areas that no pen of theirs drew; None where a drawing is more areas than lines.

    least: levels by which ink is darker than paper.
    """
    dark = ndimage.gaussian_filter((255.0 - bare) @ LUMA, 1.0) > 2.0 * least
    wide = WIDER * (float(np.quantile(pens.widths, 0.95)) + pens.blur) + 2.0
    deep = ndimage.distance_transform_edt(dark) > 0.5 * wide
    parts, count = ndimage.label(deep)
    if not count:
        return pens
    if deep.sum() > MOST_AREA * pens.widths.sum():
        return None
    inks, owners = list(pens.inks), np.full(count + 1, -1)
    for k, box in enumerate(ndimage.find_objects(parts), start=1):
        ink = np.rint(np.clip(np.median(bare[box][parts[box] == k], axis=0), 0.0, 255.0))
        gaps = [float(np.abs(ink - known).max()) for known in inks]
        owners[k] = int(np.argmin(gaps)) if min(gaps) <= OTHER else len(inks)
        if owners[k] == len(inks):
            inks.append(ink)
    y, x = np.nonzero(deep)
    return Pens(
        pens.blur,
        np.array(inks),
        np.concatenate([pens.places, np.stack([x, y], axis=1)]),
        np.concatenate([pens.owners, owners[parts[y, x]]]),
        np.concatenate([pens.widths, np.full(len(y), wide)]),
    )


def _kinds(lines: Profiles) -> np.ndarray:
    """(n,) for each profile the number of its kind, those of about one tint and mass; -1 for rare ones."""
    found = np.full(len(lines.masses), -1)
    free = lines.masses > 0.0
    size = np.log(np.maximum(lines.masses, 1e-6))
    count = 0
    while free.sum() >= FEWEST:
        middle = float(np.median(size[free]))
        first = np.flatnonzero(free)[np.abs(size[free] - middle).argmin()]
        own = free & (np.abs(size - size[first]) <= MASS)
        own &= (np.abs(lines.tints - lines.tints[first]) <= TINT).all(axis=1)
        if own.sum() >= FEWEST:
            found[own] = count
            count += 1
        free &= ~own
    return found


def _fitted(
    lines: Profiles, kinds: np.ndarray, tints: np.ndarray, grain: float
) -> tuple[float, np.ndarray, np.ndarray]:
    """The blur, px, and for each kind of line the depth of its ink, in levels of luma, and its standard error."""
    # These take a while to import, and few pictures are scans.
    from scipy.optimize import least_squares
    from scipy.special import erf

    count = len(tints)
    means = np.array([lines.depths[kinds == k].mean(axis=0) for k in range(count)])
    errors = np.array([np.hypot(grain * (ALIKE / (kinds == k).sum()) ** 0.5, ERROR) for k in range(count)])
    black = 255.0 / tints.max(axis=1)

    def off(x: np.ndarray) -> np.ndarray:
        depths, widths, grounds = x[1:].reshape(3, count)
        soft = np.sqrt(2.0 * (x[0] ** 2 + 1.0 / 12.0))  # a pixel is a square
        u, half = lines.offsets / soft, 0.5 * widths[:, None] / soft
        drawn = grounds[:, None] + 0.5 * depths[:, None] * (erf(u + half) - erf(u - half))
        rare = np.maximum(THIN - widths, 0.0) / THINNER
        return np.concatenate([((drawn - means) / errors[:, None]).ravel(), (depths / black - USUAL) / SPREAD, rare])

    least, most = np.full(3 * count + 1, 1e-3), np.full(3 * count + 1, np.inf)
    most[0], most[1 : count + 1] = MOST_BLUR, black
    least[2 * count + 1 :] = -np.inf
    begin = np.concatenate([np.full(count, 0.8) * black, means.sum(axis=1) * STEP / (0.8 * black), np.zeros(count)])
    found = least_squares(off, np.concatenate([[1.0], begin]), bounds=(least, most), x_scale="jac")
    spread = np.linalg.pinv(found.jac.T @ found.jac).diagonal()
    return float(found.x[0]), found.x[1 : count + 1], np.sqrt(spread[1 : count + 1])


def _inks(
    tints: np.ndarray, depths: np.ndarray, errors: np.ndarray, masses: np.ndarray, blur: float
) -> tuple[np.ndarray, np.ndarray]:
    """(kinds,) the ink of each kind, and (k, 3) the inks in levels: kinds of one tint and about one depth share it;
    so do those that blur leaves nothing of but that they seem a darker one.
    """
    owners, first = np.full(len(depths), -1), list[int]()
    for kind in np.argsort(errors / depths, kind="stable").tolist():
        for number, known in enumerate(first):
            off = abs(depths[kind] - depths[known])
            near = off <= max(SAME_FILL * float(np.hypot(errors[kind], errors[known])), SAME_SHARE * depths[known])
            thin = masses[kind] < THINNEST * blur * depths[kind]
            near |= thin and depths[known] < depths[kind] < MOST_DARKER * depths[known]
            if near and np.abs(tints[kind] - tints[known]).max() <= TINT:
                owners[kind] = number
                break
        else:
            owners[kind] = len(first)
            first.append(kind)
    inks = 255.0 - depths[first][:, None] * tints[first]
    return owners, np.rint(np.clip(inks, 0.0, 255.0))


def sharpened(levels: np.ndarray, pens: Pens) -> tuple[np.ndarray, np.ndarray]:
    """The ink on white paper, (H, W, 4) in levels, white where there is none, as sharp and even as pens draw it:
    float32, blends of white and one ink where these meet; and the inks (k, 4), white first.
    """
    drawn = np.any(levels[..., :3] < 255.0, axis=-1)
    owner = _owners(drawn, pens)
    # A pale ink shows in those channels that it darkens.
    depths = 255.0 - pens.inks
    weights = depths * LUMA
    weights /= (weights * depths).sum(axis=1, keepdims=True)
    share = ((255.0 - levels[..., :3]) * weights[owner]).sum(axis=-1, dtype=np.float32)
    share = _unblurred(share, pens.blur)
    share = np.where(share < SNAP, 0.0, np.where(share > 1.0 - SNAP, 1.0, share))[..., None]
    out = np.full(levels.shape, 255.0, dtype=np.float32)
    out[..., :3] += share * (pens.inks[owner] - 255.0)
    opaque = np.full((len(pens.inks) + 1, 1), 255.0)
    return out, np.hstack([np.vstack([np.full((1, 3), 255.0), pens.inks]), opaque])


def _owners(drawn: np.ndarray, pens: Pens) -> np.ndarray:
    """(H, W) for each pixel that something is drawn on the ink of the nearest line, for its width; 0 elsewhere."""
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
    """The shares in 0..1 that look like these (H, W) through a Gaussian, by accelerated projected steps (Beck and
    Teboulle 2009), which end before the grain is made much larger.
    """
    found = np.clip(share, 0.0, 1.0)
    ahead, pace = found, 1.0
    for _ in range(ROUNDS):
        missing = share - ndimage.gaussian_filter(ahead, blur, truncate=3.0)
        new = np.clip(ahead + ndimage.gaussian_filter(missing, blur, truncate=3.0), 0.0, 1.0)
        following = 0.5 * (1.0 + (1.0 + 4.0 * pace**2) ** 0.5)
        ahead = new + (pace - 1.0) / following * (new - found)
        found, pace = new, following
    return found
