"""The few points of a chain that straight lines between them keep near to all others.

Method: U. Ramer, "An iterative procedure for the polygonal approximation of plane curves", 1972; D. Douglas and
T. Peucker, "Algorithms for the reduction of the number of points required to represent a digitized line", 1973.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.raster.outlines import kept_points


def fewer_points(points: np.ndarray, tolerance: float) -> np.ndarray:
    """Those of the points (n, 2) of a chain, n >= 1, the first and the last among them, between which no other is more
    than `tolerance` off the straight line; (k, 2), in their order.
    """
    return np.asarray(points[kept_points(points, tolerance)])
