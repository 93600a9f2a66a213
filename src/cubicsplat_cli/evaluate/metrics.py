"""PSNR and SSIM of a picture against its reference, by scikit-image."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.report import Quality

# Wang et al. 2004 ("Image quality assessment: from error visibility to structural similarity"): Gaussian
# window of sigma 1.5 cut to 11 x 11 taps, population covariance, data range 1, mean over pixels and channels.
SSIM_SIGMA = 1.5
SSIM_TAPS = 11
# Far below half a step of 16 bits: differences under this come from float arithmetic, not from the pictures.
IDENTICAL_TOLERANCE = 1e-6


def compare(reference: Picture, candidate: np.ndarray) -> Quality:
    """Quality of a drawn picture, (H, W, 4) uint8 straight RGBA or (H, W, 3) uint8 RGB, against `reference`.

    Where either has transparency both are laid over black and over white, and the worse value of each measure
    is reported. Raises InputError when sizes differ.
    """
    return _compare_over(reference, *_split(premultiplied(candidate)))


def compare_premultiplied(reference: Picture, candidate: np.ndarray) -> Quality:
    """The same for a float picture, (H, W, 3) or premultiplied (H, W, 4) in [0, 1], as the own renderer gives
    it.

    Values are clipped to [0, 1] and not rounded to 8 bits. Raises InputError when sizes differ or a value is
    not finite.
    """
    return _compare_over(reference, *_split(_checked(candidate)))


def agreement_db(own: np.ndarray, drawn: np.ndarray) -> float | None:
    """PSNR in dB between the engine's own picture and an independent renderer's; None when no value differs.

    own: (H, W, 3) or premultiplied (H, W, 4) in [0, 1], not rounded. drawn: (H, W, 4) uint8 straight RGBA, as
    `rerender` gives it; its 8 bits alone cost about as much as 59 dB. Where either has transparency both are laid
    over black and over white, and the worse value is returned. Raises InputError when sizes differ or a value is not
    finite.
    """
    first, first_alpha = _split(_checked(own))
    second, second_alpha = _split(premultiplied(drawn))
    if first.shape != second.shape:
        raise InputError(f"sizes differ: {first.shape[1::-1]} and {second.shape[1::-1]} px")
    grounds = [(first, second)]
    if first_alpha is not None or second_alpha is not None:
        grounds.append((_over_white(first, first_alpha), _over_white(second, second_alpha)))
    return min((p for p in (_psnr(*ground) for ground in grounds) if p is not None), default=None)


def premultiplied(pixels: np.ndarray) -> np.ndarray:
    """(H, W, 4) uint8 straight RGBA as float32 premultiplied in [0, 1]; (H, W, 3) when every pixel is opaque."""
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise InputError(f"a drawn picture must be (H, W, 3 or 4) uint8, not {pixels.shape} {pixels.dtype}")
    values = pixels.astype(np.float32) / np.float32(255)
    if values.shape[2] == 4 and (pixels[..., 3] != 255).any():
        values[..., :3] *= values[..., 3:]
        return values
    return values[..., :3]


def _checked(values: np.ndarray) -> np.ndarray:
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InputError(f"a picture must be (H, W, 3 or 4), not {values.shape}")
    if not np.isfinite(values).all():
        raise InputError("the picture holds values that are not finite")
    return np.clip(values, 0.0, 1.0)


def _split(values: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
    return values[..., :3], values[..., 3] if values.shape[2] == 4 else None


def _compare_over(reference: Picture, colours: np.ndarray, alpha: np.ndarray | None) -> Quality:
    """`colours` premultiplied (H, W, 3), `alpha` (H, W) or None for opaque."""
    wanted = (reference.height, reference.width)
    if colours.shape[:2] != wanted:
        raise InputError(
            f"sizes differ: {reference.source} is {wanted[1]} x {wanted[0]} px, the other picture "
            f"{colours.shape[1]} x {colours.shape[0]} px; scale one of them first"
        )
    target, target_alpha = _split(reference.target())
    over_black = _quality(target, colours)
    if target_alpha is None and alpha is None:
        return over_black
    return _worse(over_black, _quality(_over_white(target, target_alpha), _over_white(colours, alpha)))


def _over_white(colours: np.ndarray, alpha: np.ndarray | None) -> np.ndarray:
    return colours if alpha is None else colours + (1.0 - alpha[..., None])


def _psnr(reference: np.ndarray, candidate: np.ndarray) -> float | None:
    """Of two (H, W, 3) pictures in [0, 1], summed in float64; None when no value differs."""
    total, worst = 0.0, 0.0
    for channel in range(3):
        # One channel at a time: a large picture in float64 would be most of the memory.
        difference = np.abs(reference[..., channel].astype(np.float64) - candidate[..., channel])
        worst = max(worst, float(difference.max()))
        total += float(np.mean(difference**2))
    return None if worst <= IDENTICAL_TOLERANCE else -10.0 * math.log10(total / 3.0)


def _quality(reference: np.ndarray, candidate: np.ndarray) -> Quality:
    """Both (H, W, 3) in [0, 1]."""
    psnr = _psnr(reference, candidate)
    if psnr is None:
        return Quality(None, 1.0, True)
    if min(reference.shape[:2]) < SSIM_TAPS:
        note = f"the picture is smaller than the {SSIM_TAPS} x {SSIM_TAPS} window of SSIM"
        return Quality(psnr, None, False, note)
    return Quality(psnr, sum(_ssim(reference[..., c], candidate[..., c]) for c in range(3)) / 3.0, False)


def _ssim(reference: np.ndarray, candidate: np.ndarray) -> float:
    """Of one channel (H, W) in [0, 1]."""
    # scikit-image takes a while to import; nothing before the first comparison needs it.
    from skimage.metrics import structural_similarity

    value = structural_similarity(
        reference.astype(np.float64),
        candidate.astype(np.float64),
        gaussian_weights=True,
        sigma=SSIM_SIGMA,
        use_sample_covariance=False,
        data_range=1.0,
    )
    return float(value)


def _worse(first: Quality, second: Quality) -> Quality:
    """The smaller value of each measure; None counts as perfect (PSNR) or unknown for both (SSIM)."""
    if first.identical and second.identical:
        return first
    psnr = min((q.psnr_db for q in (first, second) if q.psnr_db is not None), default=None)
    note = first.ssim_note or second.ssim_note
    if note is not None or first.ssim is None or second.ssim is None:
        return Quality(psnr, None, False, note)
    return Quality(psnr, min(first.ssim, second.ssim), False)
