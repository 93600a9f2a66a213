"""Further measures of a picture against its reference: CIEDE2000 by scikit-image, MS-SSIM and LPIPS by torchmetrics.

torchmetrics and torchvision, whose network LPIPS is, come with the extra `measures`. The weights of that network are
downloaded by torchvision when they are first asked for.
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

# Five scales, each half of the one before, and a window of 11 px at the last.
LEAST_MS_SSIM = 161
# Below it nothing is left of the network's last layers.
LEAST_LPIPS = 32
WHITE, BLACK = 255.0, 0.0
STRIP_PIXELS = 1 << 20
SMALL = 3.0  # levels


def further(reference: Picture, candidate: np.ndarray, names: Sequence[str]) -> dict[str, float | None]:
    """The figures of those of `names` that are in FURTHER, by their members; None for a picture too small for one.

    candidate: (H, W, 3 or 4) uint8, straight, of the reference's size. Where either has transparency both are laid over
    black and over white, and the worse figure counts. Raises EngineError, with what to do, where the packages or the
    weights of one are missing.
    """
    chosen = [name for name in names if name in FURTHER]
    if not chosen:
        return {}
    first, second = straight_rgba(reference), _with_alpha(candidate)
    opaque = bool((first[..., 3] == 255).all() and (second[..., 3] == 255).all())
    figures: dict[str, float | None] = {}
    for name in chosen:
        if name == "de00":
            figures["de00"] = _delta_e(first, second)
            continue
        grounds = (BLACK,) if opaque else (BLACK, WHITE)
        measured = (_measured(name, over(first, ground), over(second, ground)) for ground in grounds)
        values = [value for value in measured if value is not None]
        figures[FURTHER[name].member] = FURTHER[name].worse(values) if values else None
    return figures


def straight_rgba(picture: Picture) -> np.ndarray:
    """(H, W, 4) uint8 straight RGBA of a picture."""
    alpha = np.ones(picture.rgb.shape[:2], np.float32) if picture.alpha is None else picture.alpha
    return np.rint(np.dstack([picture.rgb, alpha]) * 255.0).astype(np.uint8)


def _with_alpha(pixels: np.ndarray) -> np.ndarray:
    if pixels.shape[2] == 4:
        return pixels
    return np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])


def _delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """The mean over the picture, a strip at a time."""
    height, width = first.shape[:2]
    rows = max(1, STRIP_PIXELS // width)
    strips = [slice(top, min(height, top + rows)) for top in range(0, height, rows)]
    return sum(mean_delta_e(first[s], second[s]) * (s.stop - s.start) for s in strips) / height


def _measured(name: str, first: np.ndarray, second: np.ndarray) -> float | None:
    """MS-SSIM or LPIPS of two (H, W, 3) uint8 pictures; None where they are too small."""
    least = LEAST_MS_SSIM if name == "ms-ssim" else LEAST_LPIPS
    if min(first.shape[:2]) < least:
        return None
    import torch

    tensors = [torch.from_numpy(p).permute(2, 0, 1)[None].float() / 255.0 for p in (second, first)]
    with torch.no_grad():
        if name == "lpips":
            return float(_network()(*tensors))
        library = _library("torchmetrics.functional.image", "ms-ssim")
        return float(library.multiscale_structural_similarity_index_measure(*tensors, data_range=1.0))


@lru_cache(maxsize=1)
def _network() -> Any:
    """LPIPS with AlexNet (Zhang et al. 2018), of pictures in [0, 1]."""
    library = _library("torchmetrics.image.lpip", "lpips")
    try:
        return library.LearnedPerceptualImagePatchSimilarity(net_type="alex", normalize=True).eval()
    except ModuleNotFoundError as error:
        raise EngineError("lpips needs torchvision; pip install 'cubicsplat[measures]'") from error
    except (URLError, OSError, RuntimeError) as error:
        import torch

        folder = f"{torch.hub.get_dir()}/checkpoints"
        raise EngineError(
            f"lpips: the weights of its network cannot be had ({one_line(error)}); put alexnet-owt-7be5be79.pth of "
            f"download.pytorch.org/models into {folder}, or leave lpips out"
        ) from error


def _library(module: str, name: str) -> ModuleType:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise EngineError(f"{name} needs torchmetrics ({error}); pip install 'cubicsplat[measures]'") from error
    except RuntimeError as error:
        # torchvision says so itself, in its own words, where it was built for another torch.
        raise EngineError(
            f"{name}: the torchvision that is installed does not belong to this torch ({one_line(error)}); "
            "install both from the same place"
        ) from error


def over(pixels: np.ndarray, ground: float) -> np.ndarray:
    """(H, W, 4) uint8 straight RGBA laid over a grey of 0..255: (H, W, 3) uint8."""
    alpha = pixels[..., 3:].astype(np.float32) / np.float32(255)
    return np.rint(pixels[..., :3] * alpha + np.float32(ground) * (1 - alpha)).astype(np.uint8)


def mean_delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """Mean CIEDE2000 (D65, sRGB) of two straight RGBA pictures, over white or black, whichever is worse."""
    return max(_mean_delta_e(over(first, ground), over(second, ground)) for ground in (WHITE, BLACK))


def _mean_delta_e(first: np.ndarray, second: np.ndarray) -> float:
    """Each pair of colours is converted once: flat pictures have few, and most pixels do not differ."""
    from skimage.color import deltaE_ciede2000, rgb2lab

    differs = (first != second).any(axis=-1)
    pairs, counts = np.unique(_packed(first[differs]) << np.int64(24) | _packed(second[differs]), return_counts=True)
    if not len(pairs):
        return 0.0
    channels = np.array([16, 8, 0])
    lab = [rgb2lab((packed[:, None] >> channels & 255) / 255.0) for packed in (pairs >> 24, pairs & 0xFFFFFF)]
    return float((deltaE_ciede2000(*lab) * counts).sum() / differs.size)


def _packed(colours: np.ndarray) -> np.ndarray:
    red, green, blue = np.moveaxis(colours.astype(np.int64), -1, 0)
    return red << 16 | green << 8 | blue


def metric(colours: np.ndarray) -> np.ndarray:
    """(2, ..., 3) the square of CIEDE2000 for each squared level that colours (..., 3) in levels change by a little:
    of a symmetric matrix the diagonal, then (0, 1), (0, 2) and (1, 2).
    """
    from skimage.color import deltaE_ciede2000, rgb2lab

    def along(*step: int) -> np.ndarray:
        change = SMALL * np.array(step)
        ends = (rgb2lab(np.clip(colours, SMALL, 255.0 - SMALL) / 255.0 + sign * change / 255.0) for sign in (0.5, -0.5))
        return np.asarray(np.square(deltaE_ciede2000(*ends) / SMALL))

    one = [along(1, 0, 0), along(0, 1, 0), along(0, 0, 1)]
    two = [
        0.5 * (along(1, 1, 0) - one[0] - one[1]),
        0.5 * (along(1, 0, 1) - one[0] - one[2]),
        0.5 * (along(0, 1, 1) - one[1] - one[2]),
    ]
    return np.stack([np.stack(one, axis=-1), np.stack(two, axis=-1)])
