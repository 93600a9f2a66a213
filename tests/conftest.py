"""Fixtures that several test files share: the command as users start it, and small pictures."""

from __future__ import annotations

import gc
import os
import shutil
import sys
from collections.abc import Callable, Iterator
from importlib import import_module, invalidate_caches
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import Done, run_here
from hypothesis import settings
from PIL import Image
from workers import forked_from_a_warm_process

import benchmarks

# A machine that is busy with other things must not fail a test.
settings.register_profile("few", max_examples=12, deadline=None)
settings.load_profile("few")


def pytest_configure() -> None:
    """Before torch is imported: where tests run side by side, each process computes on one core."""
    if "PYTEST_XDIST_WORKER" in os.environ:
        os.environ.setdefault("OMP_NUM_THREADS", "1")
    gc.disable()  # what is imported and collected stays: a third of the time went into looking through it


def pytest_collection_finish() -> None:
    gc.freeze()
    gc.enable()


@pytest.fixture(scope="session", autouse=True)
def _quick_workers() -> Iterator[None]:
    with forked_from_a_warm_process():
        yield


@pytest.fixture(scope="session")
def browser() -> Iterator[Any]:
    """Chromium, as playwright has it."""
    driver = pytest.importorskip("playwright.sync_api", reason="needs playwright: pip install 'cubicsplat[test]'")
    program = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome", "chrome"))), None)
    if program is None:
        pytest.skip("needs Chromium or Chrome: apt-get install chromium")
    with driver.sync_playwright() as play:
        started = play.chromium.launch(executable_path=program, args=["--no-sandbox"])
        yield started
        started.close()


@pytest.fixture(scope="session")
def opened() -> Iterator[dict[str, Any]]:
    """Engines by name, each opened once."""
    engines: dict[str, Any] = {}
    yield engines
    for engine in engines.values():
        engine.close()


@pytest.fixture
def engine(request: pytest.FixtureRequest, opened: dict[str, Any]) -> Any:
    """The engine that a test names, or the best one on the CPU.

    Not of a wider scope: pytest would then run all tests of one engine, then all of the next, and two processes that
    share them out would both compute every reference.
    """
    from engines import FIRST, open_kind

    kind = getattr(request, "param", FIRST)
    if kind not in opened:
        opened[kind] = open_kind(kind)
    return opened[kind]


@pytest.fixture
def package(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], None]:
    """Installs a package of a name and a text in the place of the one that is there, for one test."""
    folder = tmp_path_factory.mktemp("packages")
    monkeypatch.syspath_prepend(folder)

    def install(name: str, text: str) -> None:
        (folder / f"{name}.py").write_text(text)
        for loaded in [module for module in sys.modules if module.split(".")[0] == name]:
            monkeypatch.delitem(sys.modules, loaded)
        monkeypatch.setitem(sys.modules, name, None)  # so that the one put here goes with the test
        del sys.modules[name]
        invalidate_caches()

    return install


@pytest.fixture(scope="session")
def run_cli() -> Callable[..., Done]:
    """Run `cubicsplat` with arguments, in this process, as `run_here` does; stdout and stderr are bytes."""
    return run_here


@pytest.fixture(scope="session")
def run_benchmark() -> Callable[..., Done]:
    """Run `python -m benchmarks.NAME` with arguments, in this process, as `run_here` runs the command."""
    return lambda name, *given, **how: run_here(*given, program=lambda: benchmarks.main(command_of(name)), **how)


def command_of(name: str) -> Callable[..., None]:
    """The function of a benchmark, which a module or the program of a package of its name holds."""
    folder = Path(benchmarks.__file__).parent / name
    return getattr(import_module(f"benchmarks.{name}.__main__" if folder.is_dir() else f"benchmarks.{name}"), name)


def ctrl_c_when(true: Callable[..., object]) -> Callable[..., None]:
    """A callback that does as Ctrl-C does when something is true of what it is told."""

    def callback(*told: Any) -> None:
        if true(*told):
            raise KeyboardInterrupt

    return callback


ctrl_c = ctrl_c_when(lambda *_: True)


def rest_slow(*cases: Any, fast: int = 1) -> list[Any]:
    """Cases to parametrise over, each once; only the first few are fast tests, and the others show more of the same."""
    as_tuples = [case if isinstance(case, tuple) else (case,) for case in dict.fromkeys(cases)]
    return [pytest.param(*case, marks=[pytest.mark.slow] * (i >= fast)) for i, case in enumerate(as_tuples)]


def agreement_db(own: np.ndarray, drawn: np.ndarray) -> float | None:
    """PSNR between an engine's picture and a renderer's (H, W, 4) uint8."""
    from cubicsplat_cli.evaluate.images import of_pixels, of_values
    from cubicsplat_cli.evaluate.metrics import measure
    from cubicsplat_cli.files.load import Picture

    reference = Picture(np.zeros((*own.shape[:2], 3), np.float32), None, "none", "")
    return measure(reference, [of_values(own), of_pixels(drawn)])[1]


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


@pytest.fixture
def two_pictures(tmp_path: Path) -> Path:
    """A folder of two pictures, the second with transparency."""
    path = tmp_path / "pictures"
    path.mkdir()
    Image.fromarray(smooth_pixels(32, 20)).save(path / "a.png")
    Image.fromarray(smooth_pixels(24, 24, alpha=True)).save(path / "b.png")
    return path


@pytest.fixture
def noisy_file(noisy: np.ndarray, tmp_path: Path) -> Path:
    """The picture that a test file calls noisy, as a file."""
    path = tmp_path / "noisy.png"
    Image.fromarray(noisy).save(path)
    return path
