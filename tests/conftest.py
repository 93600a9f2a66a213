"""Fixtures that several test files share: the command as users start it, and small pictures."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

RunCli = Callable[..., "subprocess.CompletedProcess[bytes]"]


def cli_command() -> list[str]:
    """The console script beside this Python where the package is installed, else the module."""
    for name in ("cubicsplat", "cubicsplat.exe"):
        script = Path(sys.executable).parent / name
        if script.is_file():
            return [str(script)]
    return [sys.executable, "-m", "cubicsplat_cli"]


@pytest.fixture(scope="session")
def run_cli() -> RunCli:
    """Run `cubicsplat` with arguments in a process of its own; stdout and stderr are bytes."""

    def run(*arguments: object, data: bytes | None = None, timeout: float = 180):
        return subprocess.run(
            [*cli_command(), *(str(argument) for argument in arguments)],
            input=data,
            stdin=subprocess.DEVNULL if data is None else None,
            capture_output=True,
            timeout=timeout,
            check=False,
        )

    return run


def smooth_pixels(width: int, height: int, *, alpha: bool = False) -> np.ndarray:
    """(H, W, 3 or 4) uint8: a gradient with a disc on it, or the disc alone on nothing."""
    y, x = np.mgrid[0:height, 0:width] + 0.5
    pixels = np.stack([255 * x / width, 255 * y / height, np.full_like(x, 90.0)], axis=-1)
    inside = (x - 0.45 * width) ** 2 + (y - 0.5 * height) ** 2 < (0.3 * min(width, height)) ** 2
    pixels[inside] = (230, 60, 40)
    if alpha:
        pixels = np.concatenate([pixels, 255.0 * inside[..., None]], axis=-1)
    return pixels.astype(np.uint8)


@pytest.fixture
def photo(tmp_path: Path) -> Path:
    """A 40 x 28 opaque PNG."""
    path = tmp_path / "photo.png"
    Image.fromarray(smooth_pixels(40, 28)).save(path)
    return path


@pytest.fixture
def logo(tmp_path: Path) -> Path:
    """A 32 x 32 PNG with transparency."""
    path = tmp_path / "logo.png"
    Image.fromarray(smooth_pixels(32, 32, alpha=True)).save(path)
    return path
