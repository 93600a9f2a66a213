"""PSNR and SSIM of a picture against its reference, by scikit-image."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.image import Picture

# Wang et al. 2004 ("Image quality assessment: from error visibility to structural similarity"): Gaussian
# window of sigma 1.5 cut to 11 x 11 taps, population covariance, data range 1, mean over pixels and channels.
SSIM_SIGMA = 1.5
SSIM_TAPS = 11
# Far below half a step of 16 bits: differences under this come from float arithmetic, not from the pictures.
IDENTICAL_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Quality:
    """How close a picture is to its reference.

    psnr_db: peak signal-to-noise ratio in dB, None when the pictures are identical. ssim: mean structural
    similarity in [-1, 1], None when the picture is too small for the window (`ssim_note` says so). identical:
    no pixel differs.
    """

    psnr_db: float | None
    ssim: float | None
    identical: bool
    ssim_note: str | None = None


def compare(reference: Picture, candidate: np.ndarray) -> Quality:
    """Quality of a drawn picture, (H, W, 4) uint8 straight RGBA or (H, W, 3) uint8 RGB, against `reference`.

    Where either has transparency both are laid over black and over white, and the worse value of each measure
    is reported. Raises InputError when sizes differ.
    """
    if candidate.dtype != np.uint8 or candidate.ndim != 3 or candidate.shape[2] not in (3, 4):
        raise InputError(f"candidate must be (H, W, 3 or 4) uint8, not {candidate.shape} {candidate.dtype}")
    values = candidate.astype(np.float32) / np.float32(255)
    alpha = None
    if candidate.shape[2] == 4 and (candidate[..., 3] != 255).any():
        alpha = values[..., 3]
    colours = values[..., :3] if alpha is None else values[..., :3] * alpha[..., None]
    return _compare_over(reference, colours, alpha)


def compare_premultiplied(reference: Picture, candidate: np.ndarray) -> Quality:
    """The same for a float picture, (H, W, 3) or premultiplied (H, W, 4) in [0, 1], as the own renderer gives
    it.

    Values are clipped to [0, 1] and not rounded to 8 bits. Raises InputError when sizes differ or a value is
    not finite.
    """
    if candidate.ndim != 3 or candidate.shape[2] not in (3, 4):
        raise InputError(f"candidate must be (H, W, 3 or 4), not {candidate.shape}")
    if not np.isfinite(candidate).all():
        raise InputError("candidate holds values that are not finite")
    values = np.clip(candidate, 0.0, 1.0)
    return _compare_over(reference, values[..., :3], values[..., 3] if values.shape[2] == 4 else None)


def _compare_over(reference: Picture, colours: np.ndarray, alpha: np.ndarray | None) -> Quality:
    """`colours` premultiplied (H, W, 3), `alpha` (H, W) or None for opaque."""
    wanted = (reference.height, reference.width)
    if colours.shape[:2] != wanted:
        raise InputError(
            f"sizes differ: {reference.source} is {wanted[1]} x {wanted[0]} px, the other picture "
            f"{colours.shape[1]} x {colours.shape[0]} px; scale one of them first"
        )
    target = reference.target()
    target_alpha = target[..., 3] if target.shape[2] == 4 else None
    if target_alpha is None and alpha is None:
        return _quality(target, colours)
    over_black = _quality(target[..., :3], colours)
    over_white = _quality(_over_white(target[..., :3], target_alpha), _over_white(colours, alpha))
    return _worse(over_black, over_white)


def _over_white(colours: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    return colours if alpha is None else colours + (1.0 - alpha[..., None])


def _quality(reference: np.ndarray, candidate: np.ndarray) -> Quality:
    """Both (H, W, 3) in [0, 1]."""
    # scikit-image takes a while to import; nothing before the first comparison needs it.
    from skimage.metrics import structural_similarity

    reference, candidate = reference.astype(np.float64), candidate.astype(np.float64)
    difference = np.abs(reference - candidate)
    if difference.max() <= IDENTICAL_TOLERANCE:
        return Quality(None, 1.0, True)
    psnr = -10.0 * math.log10(float(np.mean(difference**2)))
    if min(reference.shape[:2]) < SSIM_TAPS:
        note = f"the picture is smaller than the {SSIM_TAPS} x {SSIM_TAPS} window of SSIM"
        return Quality(psnr, None, False, note)
    ssim = structural_similarity(
        reference,
        candidate,
        gaussian_weights=True,
        sigma=SSIM_SIGMA,
        use_sample_covariance=False,
        data_range=1.0,
        channel_axis=-1,
    )
    return Quality(psnr, float(ssim), False)


def _worse(first: Quality, second: Quality) -> Quality:
    """The smaller value of each measure; None counts as perfect (PSNR) or unknown for both (SSIM)."""
    if first.identical and second.identical:
        return first
    psnr = min((q.psnr_db for q in (first, second) if q.psnr_db is not None), default=None)
    note = first.ssim_note or second.ssim_note
    if note is not None or first.ssim is None or second.ssim is None:
        return Quality(psnr, None, False, note)
    return Quality(psnr, min(first.ssim, second.ssim), False)
