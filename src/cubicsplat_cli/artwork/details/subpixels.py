"""Inks arranged within pixels: each subpixel has one, and each pixel as many of each ink as that covers of it.

Where in its pixel an ink lies is told by the shares of the pixels around it: its subpixels are those at which the
shares, interpolated, have most of it, after the idea of subpixel mapping by spatial dependence (Atkinson 2005).
"""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from cubicsplat_cli.artwork.geometry.coverage import arrange

SIDE = 4  # subpixels along a pixel's side
SMOOTH = 0.4  # px, standard deviation by which interpolated shares are smoothed
KEPT = 0.15  # share by which an ink may have less at a subpixel where it is drawn


def arranged(shares: np.ndarray, drawn: np.ndarray, open_pixels: np.ndarray) -> np.ndarray:
    """(SIDE H, SIDE W) int the ink of every subpixel.

    shares: (H, W, P), sums 1. drawn: (SIDE H, SIDE W) int, the inks as they are drawn, which stay in all pixels but
    those open (H, W) bool.
    """
    inks = shares.shape[2]
    scores = np.stack([_interpolated(shares[..., p]) + KEPT * (drawn == p) for p in range(inks)], axis=2)
    y, x = np.nonzero(open_pixels)
    labels = drawn.copy()
    own = arrange(blocks(scores)[y, x], _counts(shares[y, x]))
    view = labels.reshape(len(shares), SIDE, -1, SIDE)
    view[y, :, x, :] = own.reshape(-1, SIDE, SIDE)
    return labels


def blocks(fine: np.ndarray) -> np.ndarray:
    """(H, W, SIDE^2, ...) the subpixels (SIDE H, SIDE W, ...) of each pixel, row by row."""
    height, width = fine.shape[0] // SIDE, fine.shape[1] // SIDE
    parts = fine.reshape(height, SIDE, width, SIDE, *fine.shape[2:]).swapaxes(1, 2)
    return parts.reshape(height, width, SIDE * SIDE, *fine.shape[2:])


def _interpolated(share: np.ndarray) -> np.ndarray:
    fine = ndimage.zoom(share, SIDE, order=1, mode="nearest", grid_mode=True)
    return ndimage.gaussian_filter(fine, SIDE * SMOOTH, mode="nearest")


def _counts(shares: np.ndarray) -> np.ndarray:
    """(n, P) whole subpixels for shares (n, P), SIDE^2 in each row, by the largest remainders."""
    exact = SIDE * SIDE * shares
    whole = np.floor(exact + 1e-9)
    missing = SIDE * SIDE - whole.sum(axis=1)
    order = np.argsort(whole - exact, axis=1, kind="stable")
    rank = np.argsort(order, axis=1, kind="stable")
    return (whole + (rank < missing[:, None])).astype(int)
