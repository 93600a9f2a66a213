"""Further metrics of a picture against its reference: CIEDE2000 by scikit-image, MS-SSIM and LPIPS by torchmetrics.

torchmetrics, and torchvision with the network of LPIPS, come with the extra `measures`. torchvision downloads the
weights of that network at their first use.
"""

from __future__ import annotations

import importlib
from collections.abc import Sequence
from functools import lru_cache
from types import ModuleType
from typing import Any
from urllib.error import URLError

import numpy as np

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.formatting import one_line
from cubicsplat_cli.metrics import FURTHER
from cubicsplat_cli.scene.arrays import with_channels

# The least sides, px. MS-SSIM has five scales, each half of the one before, and a window of 11 px at the last. Smaller
# pictures leave nothing of the last layers of the network of LPIPS.
LEAST_SIDES = {"ms-ssim": 161, "lpips": 32}
WHITE, BLACK = 255.0, 0.0
STRIP_PIXELS = 1 << 20


def further(reference: Picture, candidate: np.ndarray, names: Sequence[str]) -> dict[str, float | None]:
    """Return the figures of the metrics `names` that are in FURTHER, by their members; None for too small a picture.

    candidate: (H, W, 3 or 4) uint8, straight, of the reference's size. If either picture has transparency, both are
    laid over black and over white, and the worse figure counts. Raises EngineError, with a remedy, if the packages or
    the weights of a metric are missing.
    """
    chosen = [name for name in names if name in FURTHER]
    if not chosen:
        return {}
    first, second = straight_rgba(reference), with_channels(candidate, 4, 255)
    opaque = bool((first[..., 3] == 255).all() and (second[..., 3] == 255).all())
    grounds = (BLACK,) if opaque else (BLACK, WHITE)
    figures: dict[str, float | None] = {}
    for name in chosen:
        of = FURTHER[name]
        if name == "de00":
            figures[of.member] = _delta_e(first, second)
        elif min(first.shape[:2]) < LEAST_SIDES.get(name, 1):
            figures[of.member] = None
        else:
            figures[of.member] = of.worse([MEASURES[name](over(first, each), over(second, each)) for each in grounds])
    return figures


def straight_rgba(picture: Picture) -> np.ndarray:
    """Return the straight RGBA of a picture, (H, W, 4) uint8."""
    return with_channels(picture.pixels(), 4, 255)


def _delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """Return `mean_delta_e` of strips, weighted by their heights: it needs little memory."""
    height, width = first.shape[:2]
    rows = max(1, STRIP_PIXELS // width)
    strips = [slice(top, min(height, top + rows)) for top in range(0, height, rows)]
    return sum(mean_delta_e(first[s], second[s]) * (s.stop - s.start) for s in strips) / height


def _ms_ssim(first: np.ndarray, second: np.ndarray) -> float:
    library = _library("torchmetrics.functional.image", "ms-ssim")
    return float(library.multiscale_structural_similarity_index_measure(*_tensors(first, second), data_range=1.0))


def _lpips(first: np.ndarray, second: np.ndarray) -> float:
    import torch

    with torch.no_grad():
        return float(_network()(*_tensors(first, second)))


def _tensors(first: np.ndarray, second: np.ndarray) -> list[Any]:
    """Return (1, 3, H, W) torch tensors in [0, 1], the second picture first, as the metrics take them."""
    import torch

    return [torch.from_numpy(p).permute(2, 0, 1)[None].float() / 255.0 for p in (second, first)]


# The functions of two (H, W, 3) uint8 pictures for the metrics in FURTHER; `de00` lays pictures over grounds itself.
MEASURES = {"ms-ssim": _ms_ssim, "lpips": _lpips}


@lru_cache(maxsize=1)
def _network() -> Any:
    """Return LPIPS with AlexNet (Zhang et al. 2018), for pictures in [0, 1]."""
    library = _library("torchmetrics.image.lpip", "lpips")
    try:
        return library.LearnedPerceptualImagePatchSimilarity(net_type="alex", normalize=True).eval()
    except ModuleNotFoundError as error:
        raise EngineError("lpips needs torchvision; pip install 'cubicsplat[measures]'") from error
    except (URLError, OSError, RuntimeError) as error:
        import torch

        folder = f"{torch.hub.get_dir()}/checkpoints"
        advice = f"put alexnet-owt-7be5be79.pth of download.pytorch.org/models into {folder}, or leave lpips out"
        raise EngineError(f"lpips: the weights of its network cannot be had ({one_line(error)}); {advice}") from error


def _library(module: str, name: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise EngineError(f"{name} needs torchmetrics ({error}); pip install 'cubicsplat[measures]'") from error
    except RuntimeError as error:
        # torchvision raises this if it was built for another torch.
        text = f"{name}: the torchvision that is installed does not belong to this torch ({one_line(error)})"
        raise EngineError(f"{text}; install both from the same place") from error


def over(pixels: np.ndarray, ground: float) -> np.ndarray:
    """Lay (H, W, 4) uint8 straight RGBA over a grey of 0..255: (H, W, 3) uint8."""
    alpha = pixels[..., 3:].astype(np.float32) / np.float32(255)
    return np.rint(pixels[..., :3] * alpha + np.float32(ground) * (1 - alpha)).astype(np.uint8)


def mean_delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """Return the mean CIEDE2000 (D65, sRGB) of two straight RGBA pictures, the larger one over white and over black."""
    return max(opaque_delta_e(over(first, ground), over(second, ground)) for ground in (WHITE, BLACK))


def opaque_delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """Return the mean CIEDE2000 (D65, sRGB) of two (H, W, 3) uint8 pictures."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    differs = (first != second).any(axis=-1)
    if not differs.any():
        return 0.0
    return float(deltaE_ciede2000(rgb2lab(first[differs]), rgb2lab(second[differs])).sum() / differs.size)


def metric(colours: np.ndarray) -> np.ndarray:
    """Return the squared CIEDE2000 for each squared level of a small change of colours (..., 3) in levels: (2, ..., 3),
    the diagonal of a symmetric matrix, then its elements (0, 1), (0, 2) and (1, 2).
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    small = 3.0  # levels

    def along(*step: int) -> np.ndarray:
        change = small * np.array(step)
        ends = (rgb2lab(np.clip(colours, small, 255.0 - small) / 255.0 + sign * change / 255.0) for sign in (0.5, -0.5))
        return np.asarray(np.square(deltaE_ciede2000(*ends) / small))

    red, green, blue = along(1, 0, 0), along(0, 1, 0), along(0, 0, 1)
    mixed = (along(1, 1, 0) - red - green, along(1, 0, 1) - red - blue, along(0, 1, 1) - green - blue)
    return np.stack([np.stack([red, green, blue], axis=-1), 0.5 * np.stack(mixed, axis=-1)])
