"""Degradations of a drawing's picture before it is vectorized, by their names for `--input`."""

from __future__ import annotations

import io
from collections.abc import Callable
from functools import partial
from xml.etree import ElementTree

import numpy as np
from PIL import Image
from scipy.ndimage import gaussian_filter

from benchmarks.artwork.document import Document
from benchmarks.tools import Given, pixels_of
from cubicsplat_cli.errors import UsageError

QUALITY = 80  # of JPEG and WebP
BLUR_PX = 1.2  # standard deviation
NOISE_LEVELS = 4.0  # standard deviation
DRIFT_LEVELS, DRIFT_PX, SOFT_PX = 1.8, (3.0, 10.0), 0.7  # standard deviations: of colours that drift over so many px
PALETTE_COLOURS = 64
CLEAN = "clean"
# Files of these kinds have no opacity: the drawing lies over white.
OPAQUE = ("jpeg", "webp", "noisy", "drifting", "palette", "dithered")


def check_kind(kind: str) -> None:
    """Raises UsageError for a name that is not in DEGRADATIONS."""
    if kind not in DEGRADATIONS:
        raise UsageError(f"must be one of {', '.join(DEGRADATIONS)}, not {kind!r}", "input")


def with_background(document: Document, kind: str) -> None:
    """Lay the drawing over white where an input of this kind has no opacity."""
    if kind in OPAQUE:
        lay_over_white(document)


def lay_over_white(document: Document) -> None:
    """Put a white rectangle below everything else."""
    (left, top), unit = document.origin, document.unit
    box = {"x": left, "y": top, "width": (document.width + 1) * unit, "height": (document.height + 1) * unit}
    space = document.root.tag.rpartition("}")[0] + "}"
    document.root.insert(
        0, ElementTree.Element(f"{space}rect", {name: f"{v:.12g}" for name, v in box.items()} | {"fill": "#fff"})
    )


def degraded(document: Document, kind: str) -> np.ndarray:
    """(H, W, 4) uint8 straight RGBA: the drawing as a tool sees it."""
    return pixels_of(DEGRADATIONS[kind](document))


def jpeg(document: Document, quality: int = QUALITY) -> bytes:
    """Of a quality of 1 to 95, chroma at half the size (4:2:0)."""
    return _saved(document, "JPEG", quality=quality, subsampling=2)


def _saved(document: Document, kind: str, **options: int) -> bytes:
    buffer = io.BytesIO()
    _without_opacity(document).save(buffer, kind, **options)
    return buffer.getvalue()


def _blurred(document: Document) -> np.ndarray:
    """By a Gaussian."""
    return _straight(gaussian_filter(_premultiplied(document.draw()), (BLUR_PX, BLUR_PX, 0.0), mode="nearest"))


def _enlarged(document: Document) -> np.ndarray:
    """Drawn at half the size and made twice as large, by cubic convolution."""
    across, down = -(-document.width // 2), -(-document.height // 2)
    small = document.draw(0.5, window=(0, 0, 2 * across, 2 * down))
    large = Image.fromarray(small).resize((2 * across, 2 * down), Image.Resampling.BICUBIC)
    return np.array(large)[: document.height, : document.width]


def _reduced(document: Document) -> np.ndarray:
    """Drawn at four times the size and reduced by Lanczos' filter, as programs make smaller copies."""
    large = Image.fromarray(document.draw(4.0))
    return np.array(large.resize((document.width, document.height), Image.Resampling.LANCZOS))


def _noisy(document: Document) -> np.ndarray:
    """With normal noise that is the same each time."""
    pixels = document.draw().copy()
    noise = np.random.default_rng(0).normal(0.0, NOISE_LEVELS, (*pixels.shape[:2], 3))
    pixels[..., :3] = np.clip(np.rint(pixels[..., :3] + noise), 0, 255)
    return pixels


def clouds(rng: np.random.Generator, size: tuple[int, int, int], px: float, levels: float) -> np.ndarray:
    """(H, W, C) float64: normal noise of a standard deviation of so many levels, alike over so many px."""
    noise = gaussian_filter(rng.normal(size=size), (px, px, 0.0))
    return np.asarray(levels / noise.std() * noise)


def _drifting(document: Document) -> np.ndarray:
    """With soft edges and colours that drift over a few px and over more, as in the pictures of generators."""
    pixels, rng = document.draw().astype(float), np.random.default_rng(0)
    height, width, _ = pixels.shape
    levels = gaussian_filter(pixels[..., :3], (SOFT_PX, SOFT_PX, 0.0)) + rng.normal(0.0, 0.5, (height, width, 3))
    for px in DRIFT_PX:
        levels += clouds(rng, (height, width, 1), px, DRIFT_LEVELS)
    return np.dstack([np.clip(np.rint(levels), 0, 255), pixels[..., 3]]).astype(np.uint8)


def _palette(document: Document) -> np.ndarray:
    """In at most 64 colours, as small PNG and GIF files are."""
    return np.array(_without_opacity(document).quantize(PALETTE_COLOURS).convert("RGBA"))


def _dithered(document: Document) -> np.ndarray:
    """In the 216 colours of old browsers, by error diffusion, as old GIF files are."""
    return np.array(_without_opacity(document).convert("P").convert("RGBA"))


def _without_opacity(document: Document) -> Image.Image:
    return Image.fromarray(document.draw()[..., :3].copy())


def _premultiplied(pixels: np.ndarray) -> np.ndarray:
    levels = pixels.astype(np.float64)
    levels[..., :3] *= levels[..., 3:] / 255.0
    return levels


def _straight(levels: np.ndarray) -> np.ndarray:
    alpha = levels[..., 3:] / 255.0
    colours = np.divide(levels[..., :3], alpha, out=np.zeros_like(levels[..., :3]), where=alpha > 0.0)
    return np.clip(np.rint(np.concatenate([colours, levels[..., 3:]], axis=2)), 0, 255).astype(np.uint8)


# Pixels as `degraded` gives them, or the bytes of a file that says how it is compressed.
DEGRADATIONS: dict[str, Callable[[Document], Given]] = {
    CLEAN: Document.draw,
    "jpeg": jpeg,
    "webp": partial(_saved, kind="WEBP", quality=QUALITY),
    "blurred": _blurred,
    "enlarged": _enlarged,
    "reduced": _reduced,
    "noisy": _noisy,
    "drifting": _drifting,
    "palette": _palette,
    "dithered": _dithered,
}
