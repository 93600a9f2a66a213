"""Places along the middle of thin lines, and how dark a picture is across them."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster.point_tree import PointTree
from cubicsplat_cli.record import record

SCALE = 1.2  # px, standard deviation of the Gaussian whose derivatives tell where lines run
# Along a line the depth bends less than a share of how it bends across it; and across by so much for its depth.
ALONG, ACROSS = 0.15, 0.04
NEAR = 0.6  # px from a pixel's middle to that of the line in it: both pixels beside one have it
REACH, STEP = 8.0, 0.5  # px to either side of a line, and between the samples of a profile
OUTER = 3  # samples at either end that hold nothing but paper beside a line that is alone
AROUND, FEWEST = 8.0, 6  # px within which places belong together, and how many there must be


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


def profiles_of(dark: np.ndarray, luma: np.ndarray, least: float, even: float) -> Profiles:
    """The profiles across all lines that are alone within REACH.

    dark: (H, W, 3) levels by which a picture is darker than its paper; luma: (3,) weights of the channels; least:
    levels of depth that a line has; even: levels of what may be left of one at the ends of a profile.
    """
    depth = dark @ luma
    places, ways = _ridges(depth, least)
    offsets = np.arange(-REACH, REACH + 0.5 * STEP, STEP)
    depths = _sampled(depth, places, ways, offsets)
    outer = np.concatenate([depths[:, :OUTER], depths[:, -OUTER:]], axis=1).reshape(-1, 2, OUTER).mean(axis=2)
    alone = (np.abs(outer) <= even).all(axis=1)
    places, ways, depths = places[alone], ways[alone], depths[alone]
    near = PointTree(places).query_ball_point(places, AROUND) if len(places) else []
    many = np.array([len(own) >= FEWEST for own in near], dtype=bool)
    own = np.stack([_sampled(dark[..., k], places, ways, offsets).sum(axis=1) * STEP for k in range(3)], axis=-1)
    masses = np.array([own[part].mean(axis=0) for part in near]).reshape(-1, 3)[many]
    total = masses @ luma
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
