"""Whether a drawing has the truth's colours exactly."""

from __future__ import annotations

import numpy as np

LEAST_SHARE = 5e-4  # of the picture's px, for a colour to be an ink


def exact_inks(truth: np.ndarray, candidate: np.ndarray) -> float | None:
    """Share of the truth's inks that the candidate has to the last level, on at least half of their area.

    Both straight RGBA (H, W, 4) uint8. An ink is a colour that fills 3 x 3 px somewhere, which blends along edges do
    not, and in such places at least 0.05 % of the px; None where the truth has none. Levels of a gradient count too.
    """
    flat = _packed(truth)[_interior(_packed(truth))]
    colours, areas = np.unique(flat, return_counts=True)
    inks = {
        c: area for c, area in zip(colours, areas, strict=True) if area >= LEAST_SHARE * truth[..., 0].size and c & 255
    }
    if not inks:
        return None
    found = dict(zip(*np.unique(_packed(candidate), return_counts=True), strict=True))
    return sum(bool(found.get(colour, 0) >= 0.5 * area) for colour, area in inks.items()) / len(inks)


def _interior(colours: np.ndarray) -> np.ndarray:
    """(H, W) bool: the px that are the middle of 3 x 3 px of one colour."""
    across = np.zeros(colours.shape, dtype=bool)
    across[:, 1:-1] = (colours[:, 1:-1] == colours[:, :-2]) & (colours[:, 1:-1] == colours[:, 2:])
    inside = np.zeros(colours.shape, dtype=bool)
    inside[1:-1] = across[1:-1] & across[:-2] & across[2:]
    inside[1:-1] &= (colours[1:-1] == colours[:-2]) & (colours[1:-1] == colours[2:])
    return inside


def _packed(pixels: np.ndarray) -> np.ndarray:
    return np.ascontiguousarray(pixels).view(">u4")[..., 0]
