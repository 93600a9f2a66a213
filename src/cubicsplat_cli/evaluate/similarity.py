"""SSIM of a part of a picture: the sums over its windows, which add up to the figure of the whole.

Wang et al. 2004 ("Image quality assessment: from error visibility to structural similarity"): Gaussian window of sigma
1.5 cut to 11 x 11 taps, population covariance, data range 1; the mean over the windows that lie within the picture, and
over the channels. scikit-image computes the same of whole pictures in float64; the tests hold this against it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cubicsplat_cli.raster.cpu import native

TAPS = 11
REACH = TAPS // 2  # of a window from its middle, px


def similarity_sums(reference: np.ndarray, candidates: Sequence[np.ndarray]) -> list[float]:
    """For each candidate the sum of SSIM over the windows of one channel.

    All (H, W) float32 in [0, 1], H and W at least 11; there are (H - 10) * (W - 10) windows. Candidates are compared at
    once because what is smoothed of the reference then serves all of them. Raises EngineError where memory is missing.
    """
    sums = np.zeros(len(candidates))
    native("comparison", "cs_similarity", np.stack([reference, *candidates]), len(candidates), *reference.shape, sums)
    return sums.tolist()
