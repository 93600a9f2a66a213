"""The few points of a chain that straight lines between them keep near to all others.

Method: U. Ramer, "An iterative procedure for the polygonal approximation of plane curves", 1972; D. Douglas and
T. Peucker, "Algorithms for the reduction of the number of points required to represent a digitized line", 1973.
"""

from __future__ import annotations

import numpy as np


def fewer_points(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Those of the points (n, 2) of a chain, n >= 1, the first and the last among them, between which no other is more
    than `tolerance` off the straight line; (k, 2), in their order.
    """
    places = points[:, 0] + 1.0j * points[:, 1]
    kept = np.zeros(len(points), dtype=bool)
    kept[[0, -1]] = True
    left = [(0, len(points) - 1)]
    while left:
        first, last = left.pop()
        if last - first < 2:
            continue
        away = places[first + 1 : last] - places[first]
        way = complex(places[last] - places[first])
        square = abs(way) ** 2
        turned = away * way.conjugate()
        beside = (turned.real > 0.0) & (turned.real < square)
        # From the line where a point lies beside it, from the nearer one of its ends elsewhere.
        nearer = np.minimum(np.abs(away), np.abs(away - way))
        gaps = np.where(beside, np.abs(turned.imag) / max(abs(way), 1e-300), nearer)
        farthest = int(gaps.argmax())
        if gaps[farthest] > tolerance:
            middle = first + 1 + farthest
            kept[middle] = True
            left += [(first, middle), (middle, last)]
    return np.asarray(points[kept])
