"""The same curve has many descriptions; this picks the one with the fewest digits.

A ring can begin at any of its anchors, and every curve can be run through backwards: the picture is the same, since the
nonzero rule does not mind the direction and round caps are alike.
"""

from __future__ import annotations

import numpy as np

_POWERS = 10 ** np.arange(1, 19, dtype=np.int64)


def shortest_description(points: np.ndarray, *, closed: bool, turn: bool = True) -> np.ndarray:
    """(N, K, 2) int64 control points of the same curves, each begun and run through where its text is shortest.

    turn: whether a curve may be run through backwards; one ring of several may not.
    """
    if not turn:
        return _best_beginning(points)
    backwards = np.concatenate([points[:, :1], points[:, :0:-1]], axis=1) if closed else points[:, ::-1]
    if closed:
        points, backwards = _best_beginning(points), _best_beginning(backwards)
    shorter = _length_of_text(backwards, closed) < _length_of_text(points, closed)
    return np.where(shorter[:, None, None], backwards, points)


def _best_beginning(rings: np.ndarray) -> np.ndarray:
    """Each ring turned so that it begins at the anchor with the shortest text, the first of them."""
    anchors, handles = rings[:, ::3], rings[:, 1::3]
    # A minus right after a letter is one more; elsewhere it saves the space.
    signs = (anchors[..., 0] < 0).astype(np.int64) + (handles[..., 0] < anchors[..., 0])
    first = 3 * (_digits(anchors).sum(-1) + signs).argmin(-1)
    order = (first[:, None] + np.arange(rings.shape[1])) % rings.shape[1]
    return np.take_along_axis(rings, order[..., None], axis=1)


def _length_of_text(points: np.ndarray, closed: bool) -> np.ndarray:
    """(N,) characters of each curve's path data, every cubic in its shorter form, but for what all have alike."""
    per_curve = points.shape[1]
    starts = 3 * np.arange(per_curve // 3)
    ends = starts[:, None] + np.array([1, 2, 3])
    absolute = points[:, ends % per_curve if closed else ends]
    relative = absolute - points[:, starts][:, :, None]
    cubics = np.minimum(_digits(absolute).sum((-1, -2)), _digits(relative).sum((-1, -2))).sum(-1)
    signs = (points[:, 0, 0] < 0).astype(np.int64) + (relative[:, 0, 0, 0] < 0)
    return cubics + _digits(points[:, 0]).sum(-1) + signs


def _digits(values: np.ndarray) -> np.ndarray:
    return 1 + np.searchsorted(_POWERS, np.abs(values), side="right")
