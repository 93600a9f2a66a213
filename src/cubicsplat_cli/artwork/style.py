"""Which style suits a picture: artwork where it is flat, photo where it is not."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.inks import CLEAR, flat_pixels

# A picture is artwork when so much of what it draws is flat, or fewer flat pixels hold to few inks.
FLAT_SHARE, SOME_FLAT, INK_SHARE = 0.5, 0.3, 0.8
# So many inks are few; a flat pixel belongs to the ink of its level, cells of CELL levels.
FEW_INKS, CELL = 24, 8.0
WORKING_SIDE = 1024


def choose_style(picture: np.ndarray) -> tuple[str, str]:
    """("artwork" or "photo", the reason in a few words) for (H, W, 3) or (H, W, 4) premultiplied, in [0, 1]."""
    flat, few = flatness(picture)
    words = f"{flat:.0%} of the picture is flat"
    if flat >= FLAT_SHARE:
        return "artwork", words
    if flat >= SOME_FLAT and few >= INK_SHARE:
        return "artwork", f"{words}, {few:.0%} of that in {FEW_INKS} inks"
    return "photo", f"only {words}"


def flatness(picture: np.ndarray) -> tuple[float, float]:
    """The share of what is drawn that is flat, exactly even over 3x3 pixels or nearly so, and the share of the flat
    pixels that the FEW_INKS commonest inks hold. Of a large picture the middle WORKING_SIDE px each way are taken.
    """
    levels = np.asarray(_middle(picture), dtype=np.float32) * np.float32(255.0)
    if levels.shape[-1] == 4:
        drawn = levels[..., 3] > CLEAR
    else:
        levels = np.concatenate([levels, np.full_like(levels[..., :1], 255.0)], axis=-1)
        drawn = np.ones(levels.shape[:2], dtype=bool)
    if not drawn.any():
        return 1.0, 1.0
    flat = flat_pixels(levels) & drawn
    if not flat.any():
        return 0.0, 0.0
    cells = np.floor(levels[flat] / CELL).astype(np.int64)
    keys = ((cells[:, 0] * 64 + cells[:, 1]) * 64 + cells[:, 2]) * 64 + cells[:, 3]
    counts = np.sort(np.unique(keys, return_counts=True)[1])[::-1]
    return float(flat.sum() / drawn.sum()), float(counts[:FEW_INKS].sum() / counts.sum())


def _middle(picture: np.ndarray) -> np.ndarray:
    height, width = picture.shape[:2]
    top, left = max(0, (height - WORKING_SIDE) // 2), max(0, (width - WORKING_SIDE) // 2)
    return picture[top : top + WORKING_SIDE, left : left + WORKING_SIDE]
