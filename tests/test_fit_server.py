"""Several fits at once in the process that owns the GPU: the same results as one at a time, and each fails alone."""

from __future__ import annotations

import multiprocessing
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from multiprocessing import Pipe
from pathlib import Path

import numpy as np
import pytest
from cli_runs import contents, save_pictures, wait_until
from conftest import ctrl_c, smooth_pixels
from emulated import EmulatedDriver, EmulatedKernels, compiler

from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.jobs.plan import plan
from cubicsplat_cli.jobs.pool import run_in_workers
from cubicsplat_cli.jobs.results import prepare_files
from cubicsplat_cli.jobs.run import DONE, FAILED, INTERRUPTED
from cubicsplat_cli.photo import remote
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.progress import Observer
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.engines import open_engine
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.scene_reader import read_svg

SETTINGS = FitSettings.from_preset(curves=10, steps=60, threads=1, device="auto")
ONE_AT_A_TIME = threading.Lock()  # the emulator has one memory for the blocks of all launches


class OneAtATime(EmulatedKernels):
    def _run(self, *arguments) -> None:
        with ONE_AT_A_TIME:
            super()._run(*arguments)


class SharedDriver(EmulatedDriver):
    """One device for all fits, each on a stream of its own."""

    _of_thread = threading.local()

    @property
    def recording(self):
        return getattr(self._of_thread, "recording", None)  # a capture is of one thread, as on a GPU

    @recording.setter
    def recording(self, launches) -> None:
        self._of_thread.recording = launches

    def _load(self, program):
        kernels = super()._load(program)
        kernels.__class__ = OneAtATime
        return kernels

    def stream(self) -> int:
        return threading.get_ident()


def on_cpu(*_, **options):
    return open_engine("cpu", 1)


@contextmanager
def served(opened=on_cpu):
    """Within, the fits of this process are done by threads of a server."""
    ours, theirs = Pipe()
    server = threading.Thread(target=remote.serve, args=(theirs, opened))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("signal.signal", lambda *_: None)  # which only a main thread may call
        server.start()
        address = ours.recv()
    remote.use_server(remote.FitServer(address))
    try:
        yield
    finally:
        remote.use_server(None)
        ours.close()
        server.join()


def picture(number: int, width: int = 40, height: int = 30) -> np.ndarray:
    shown = np.roll(smooth_pixels(width, height)[..., :3], 3 * number, axis=1)
    return np.ascontiguousarray(shown, np.float32) / 255.0


def values(result) -> list[bytes]:
    return [array.tobytes() for array in result.scene.arrays_by_name().values()]


def in_parts(fit):
    """A fit as budgets do it: with a look at its curves on the way, and then with others."""
    assert fit.relax(0.5)
    order = np.argsort(-fit.importance(), kind="stable")
    assert fit.scene().curves == len(order)
    fit.resize(order[:7], 9)
    return fit.finish()


@pytest.mark.parametrize("device", ["cpu", pytest.param("emulated", marks=pytest.mark.skipif(
    compiler() is None, reason="needs a C++ compiler"))])  # fmt: skip
def test_fits_at_once_give_the_bits_of_fits_one_after_the_other(device):
    steps, side, driver = (60, 40, None) if device == "cpu" else (12, 24, SharedDriver())

    def opened(*_, **options):
        return on_cpu() if driver is None else CudaEngine(driver=driver)

    settings = replace(SETTINGS, steps=steps)
    pictures = [picture(number, side, 20) for number in range(4)]
    alone = [values(in_parts(FitLoop(target, settings, opened=opened))) for target in pictures]
    with served(opened), ThreadPoolExecutor(4) as threads:
        together = threads.map(lambda target: values(in_parts(remote.begin_fit(target, settings))), pictures)
        assert list(together) == alone
    assert alone[0] != alone[1]


@pytest.mark.gpu
def test_fits_at_once_on_a_gpu_come_as_far_as_alone():
    """A GPU adds gradients in any order, so fits differ a little."""
    settings = FitSettings.from_preset(curves=64, steps=400, device="cuda")
    pictures = [picture(number, 300, 200) for number in range(8)]
    alone = [FitLoop(target, settings).finish().history[-1]["psnr_db"] for target in pictures]
    with served(open_engine), ThreadPoolExecutor(8) as threads:
        together = list(threads.map(lambda target: remote.begin_fit(target, settings).finish(), pictures * 3))
    assert {result.device["name"] for result in together} == {"cuda"}
    assert [result.history[-1]["psnr_db"] for result in together] == pytest.approx(alone * 3, abs=0.7)


@pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")
def test_steps_in_a_row_give_the_bits_of_single_steps():
    settings, found = replace(SETTINGS, curves=4, steps=160), []
    for at_once in (1, CudaEngine.at_once):
        engine = CudaEngine(driver=EmulatedDriver())
        engine.at_once = at_once
        loop = FitLoop(picture(0, 16, 12), settings, opened=lambda *_, e=engine, **__: e)
        calls = []
        steps = engine.steps
        engine.steps = lambda *a, steps=steps, calls=calls: (calls.append(len(a[3])), steps(*a))[1]
        found.append(values(loop.finish()))
        assert sum(calls) == settings.steps
        assert max(calls) == (1 if at_once == 1 else 4)
    assert found[0] == found[1]


def test_a_failing_fit_fails_alone_with_its_own_error_and_traceback():
    with served(), ThreadPoolExecutor(2) as threads:
        good = threads.submit(lambda: values(remote.begin_fit(picture(1), SETTINGS).finish()))
        with pytest.raises(InputError, match="not finite") as raised:
            remote.begin_fit(np.full((8, 8, 3), np.nan, np.float32), SETTINGS)
        assert "in _checked" in str(raised.value.__cause__)
        assert good.result() == values(FitLoop(picture(1), SETTINGS, opened=on_cpu).finish())


def test_an_interruption_ends_one_fit_and_keeps_what_it_has():
    long = replace(SETTINGS, steps=10_000_000)
    with served():
        other = remote.begin_fit(picture(0), SETTINGS)
        assert other.relax(0.1)
        fit = remote.begin_fit(picture(1), long, on_progress=ctrl_c)
        assert not fit.relax()
        result = fit.finish()
        assert result.interrupted
        assert 0 < result.steps < long.steps
        assert result.scene.curves > 0
        assert not other.finish().interrupted


def test_an_interruption_that_comes_too_late_ends_the_next_part():
    ours, theirs = Pipe()
    thread = threading.Thread(target=remote.serve_fit, args=(theirs, on_cpu))
    thread.start()
    for request in (("begin", (picture(0), SETTINGS, FitInputs())), None, ("relax", (1.0,)), ("finish", ())):
        ours.send(request)
    answers = [ours.recv() for _ in range(3)]
    ours.close()
    thread.join()
    assert answers[:2] == [("result", None), ("result", False)]
    assert answers[2][1].interrupted


def test_the_server_keeps_no_fit_that_its_client_has_dropped():
    opened: list[bool] = []

    def counted(*_, **options):
        engine = on_cpu()
        close = engine.close
        opened.append(True)
        engine.close = lambda: (close(), opened.pop() if opened else None)
        return engine

    with served(counted):
        for number in range(5):
            fit = remote.begin_fit(picture(number), SETTINGS)
            fit.relax(0.1)
            assert len(opened) == 1
            del fit
            wait_until(lambda: not opened)


def test_fits_that_a_gpu_cannot_do_stay_in_their_process():
    with served():
        for settings, inputs in (
            (replace(SETTINGS, device="cpu"), FitInputs()),
            (SETTINGS, FitInputs(ground=picture(0))),
        ):
            assert isinstance(remote.begin_fit(picture(0), settings, inputs), FitLoop)


def test_a_server_whose_gpu_is_broken_ends(monkeypatch):
    def broken(priority):
        raise RuntimeError("CUDA error: an illegal memory access was encountered")

    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    monkeypatch.setattr("torch.cuda.Stream", broken)
    monkeypatch.setattr("os._exit", sys.exit)
    with pytest.raises(SystemExit):
        remote._own_stream()


def test_without_its_server_a_client_ends(tmp_path):
    remote.use_server(remote.FitServer(str(tmp_path / "nobody")))
    try:
        with pytest.raises(SystemExit):
            remote.begin_fit(picture(0), SETTINGS)
    finally:
        remote.use_server(None)


class Watch(Observer):
    """Counts the pictures under way, and acts when a fit makes progress."""

    def __init__(self, act=lambda: None) -> None:
        self.under_way, self.most, self.notes, self._act = set(), 0, [], act

    def begin(self, job: str) -> None:
        self.under_way.add(job)
        self.most = max(self.most, len(self.under_way))

    def step(self, progress, job: str) -> None:
        self._act()

    def note(self, text: str, job: str = "") -> None:
        self.notes.append(text)


def run(
    folder: Path, out: Path, workers: int, observer: Watch, stopping=lambda: False, gpu=True, **options
) -> dict[str, str]:
    """Do the pictures of a folder; return the status of each."""
    settings = FitSettings.from_preset(**{"curves": 10, "steps": 60, "threads": workers, "device": "auto", **options})
    request, statuses = Request(settings, style="photo"), {}
    jobs = plan([str(folder)], str(out), request, recursive=False).jobs
    for job in jobs:
        prepare_files(job)
    for outcome in run_in_workers(
        iter(jobs), request, workers=workers, observer=observer, stopping=stopping, gpu=gpu
    ):  # fmt: skip
        observer.under_way.discard(outcome.job.name)
        statuses[Path(outcome.job.name).name] = outcome.status
    return statuses


@pytest.fixture
def folder(tmp_path) -> Path:
    save_pictures(tmp_path / "in", [f"{name}.png" for name in "abcd"])
    return tmp_path / "in"


def test_a_folder_through_the_server_has_the_files_of_one_picture_at_a_time(folder, tmp_path):
    (folder / "bad.png").write_bytes((folder / "a.png").read_bytes()[:60])
    one = run(folder, tmp_path / "one", 1, Watch(), gpu=False)
    several = run(folder, tmp_path / "several", 3, watch := Watch())
    assert several == one == {"bad.png": FAILED} | {f"{name}.png": DONE for name in "abcd"}
    assert watch.most == 3, "no more pictures are in memory than asked for"
    assert contents(tmp_path / "one") == contents(tmp_path / "several")


def test_a_stop_ends_the_fits_of_the_server_and_keeps_what_they_have(folder, tmp_path):
    asked: list[bool] = []
    watch = Watch(lambda: asked.append(True))
    found = run(folder, tmp_path / "out", 2, watch, lambda: len(asked) > 5, steps=2_000_000)
    assert set(found.values()) == {INTERRUPTED}
    assert 1 <= len(found) <= 2
    for name in found:
        assert read_svg((tmp_path / "out" / name).with_suffix(".svg").read_bytes()).curves > 0


def test_the_pictures_of_a_server_that_dies_are_tried_again(folder, tmp_path):
    killed: list[int] = []

    def kill_once() -> None:
        servers = [child for child in multiprocessing.active_children() if child.name == "serve"]
        if not killed:
            killed.extend(server.pid for server in servers)
            servers[0].kill()

    found = run(folder, tmp_path / "out", 2, watch := Watch(kill_once), steps=4000)
    assert found == {f"{name}.png": DONE for name in "abcd"}
    assert len(killed) == 1
    assert watch.notes
    assert all(note.endswith("(exit code 1); it is tried again") for note in watch.notes)


def test_a_picture_that_ends_its_server_again_fails(folder, tmp_path):
    for name in "bcd":
        (folder / f"{name}.png").unlink()

    def kill() -> None:
        for child in multiprocessing.active_children():
            if child.name == "serve":
                child.kill()

    found = run(folder, tmp_path / "out", 2, Watch(kill), steps=4000)
    assert found == {"a.png": FAILED}


def ends_at_once(pipe) -> None:
    pipe.close()


def test_a_server_that_cannot_begin_is_one_line(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.jobs.pool.serve", ends_at_once)
    with pytest.raises(EngineError, match="use --device cpu"):
        run(folder, tmp_path / "out", 2, Watch())
