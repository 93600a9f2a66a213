"""What the emulator shows of the CUDA kernels: orders of threads, sizes of lists, replays; and its own checks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from itertools import product
from pathlib import Path

import numpy as np
import pytest
import torch
from conftest import rest_slow
from emulated import APPROXIMATE, EmulatedDriver, compiler
from engines import assert_like_cpu, close, packed, state_for
from scenes import COVERAGES, DEGENERATE, PAPER, random_scene, random_target

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.cuda.frame import MOST_LOOKS, StepFrame, sizes_of, workspace
from cubicsplat_cli.raster.engine import Pass, Rates, Training
from cubicsplat_cli.raster.engines import open_engine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import FitSettings, Mode

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")
SETTINGS = RELAXED, EXACT = RasterSettings("relaxed", 1.5, 8), RasterSettings("exact", 1.0, 8)


@pytest.fixture(scope="module")
def engine():
    return CudaEngine(driver=EmulatedDriver())


def scene_and_target(mode=Mode.CLOSED, curves=24, width=45, height=37, seed=1, background=PAPER, **options):
    scene = random_scene(mode, curves, 3, width, height, seed, background=background, **options)
    return packed(scene), random_target(scene, seed)


@pytest.mark.parametrize(("mode", "settings"), rest_slow((Mode.CLOSED, EXACT), *product(Mode, SETTINGS)))
def test_results_do_not_depend_on_the_order_of_threads(engine, mode, settings):
    scene, target = scene_and_target(mode)
    picture = engine.render(scene, settings)
    _, want = engine.gradients(scene, settings, target=target, importance="loo")
    for order in (7, 12345):
        other = CudaEngine(driver=EmulatedDriver(order=order))
        assert torch.equal(other.render(scene, settings), picture)
        for name, value in other.gradients(scene, settings, target=target, importance="loo")[1].items():
            assert close(value, want[name], 1e-5), name


@pytest.mark.parametrize(("mode", "channels", "every"), rest_slow((Mode.CLOSED, 3, 3), *product(Mode, (3, 4), (1,))))
def test_results_do_not_depend_on_the_last_places(engine, mode, channels, every):
    """A GPU fuses products and sums, and its roots and quotients are approximate; the self-test passes it."""
    program = Program(mode, channels)
    rough = CudaEngine(program=program, driver=EmulatedDriver(extra=APPROXIMATE))
    for settings in SETTINGS:
        scene, target = scene_and_target(mode, background=PAPER if channels == 3 else None)
        assert not torch.equal(rough.render(scene, settings), engine.render(scene, settings))
        assert_like_cpu(rough, scene, settings, target)
    for name, scene in DEGENERATE[::every]:
        if Program.of(packed(scene)) == program:
            pictures = [e.render(packed(scene), RELAXED) for e in (rough, engine)]
            assert close(*pictures, 1e-3), name


@pytest.mark.parametrize("value", ["opacities", "colours", "points"])
def test_what_is_not_a_number_shows_in_the_loss_or_the_fault(value):
    """A minimum with NaN is the other number on a GPU: a curve without opacity would turn opaque."""
    own = CudaEngine(driver=EmulatedDriver())
    scene, target = scene_and_target()
    getattr(scene, value).view(-1)[0] = float("nan")
    loss = float(own.step(scene, RELAXED, Training(target, state_for(scene), Rates(0.1, 0.1, 0.1, 0.0))))
    assert value == "points" or loss != loss
    assert own.fault() is not None


@pytest.mark.parametrize(("shared_kb", "settings"), rest_slow((64, EXACT), *product((64, 76, 100), SETTINGS)))
def test_outlines_that_are_searched_again_give_the_same(engine, shared_kb, settings):
    """Multiprocessors with less shared memory keep fewer nearest edges for the backward pass, or none."""
    small = CudaEngine(driver=EmulatedDriver(shared_per_sm=shared_kb * 1024))
    scene, _ = scene_and_target()
    few, usual = (each._frame(scene, settings, Pass(None), backward=True).slots for each in (small, engine))
    assert few < usual == 16
    for mode in Mode:
        scene, target = scene_and_target(mode)
        _, want = engine.gradients(scene, settings, target=target)
        for name, value in small.gradients(scene, settings, target=target)[1].items():
            assert close(value, want[name], 1e-5), name


MANY = {
    "batches": (45, (20, 18), 0.4, (0.02, 0.05)),  # two in a tile
    "lists": (700, (17, 17), 0.5, (0.001, 0.004)),  # more than the tile's holds
    "rounds": (2300, (40, 20), 0.02, (0.3, 0.9)),  # more than one of the listing
}


@pytest.mark.parametrize(
    ("many", "coverage"),
    rest_slow(("batches", "exact"), ("lists", "relaxed"), *product(MANY, COVERAGES), fast=2),
)
def test_more_curves_than_any_list_holds(engine, many, coverage):
    curves, size, scale, opacity = MANY[many]
    scene, target = scene_and_target(Mode.CLOSED, curves, *size, scale=scale, opacity=opacity)
    # Curves of a pixel's size are sampled by 16 lines where the whole ring lies in a strip, on the CPU in a block.
    assert_like_cpu(engine, scene, RasterSettings(coverage, 1.0, 4), target, tolerance=5e-3)


def test_every_pixel_of_a_tile_hidden_early(engine):
    """Batches behind opaque curves are not visited, on the way back neither."""
    scene, target = scene_and_target(Mode.CLOSED, 80, 20, 18, scale=1.2, opacity=(0.95, 1.0))
    assert_like_cpu(engine, scene, RELAXED, target)


@pytest.mark.parametrize(
    ("mode", "segments"), rest_slow(*zip(Mode, (42, 16), strict=True), *product(Mode, (4, 16, 42)), fast=2)
)
def test_curves_of_many_edges(engine, mode, segments):
    """A batch of curves with 4 words of edges is smaller, down to a single curve."""
    scene = random_scene(mode, 20, segments, 40, 33, 3, background=None)
    settings = RasterSettings("relaxed", 1.0, 64)
    assert_like_cpu(engine, packed(scene), settings, random_target(scene))


@pytest.mark.parametrize("size", rest_slow(((300, 20),), ((20, 300),)))
def test_pictures_of_several_super_tiles(size):
    """Sorted into super-tiles, as many curves in many tiles are, and looked at one by one in every tile."""
    scene, target = scene_and_target(Mode.OPEN, 60, *size, scale=0.1)
    engine = CudaEngine(driver=EmulatedDriver())
    assert_like_cpu(engine, scene, RELAXED, target)
    looked = engine.render(scene, RELAXED)
    engine.most_looks = 0
    before = len(engine._driver.launches)
    assert torch.equal(engine.render(scene, RELAXED), looked)
    assert [launch[0] for launch in engine._driver.launches[before:]] == [
        "set_step",
        "flatten",
        "bin",
        "raster_relaxed",
    ]
    assert_like_cpu(engine, scene, RELAXED, target)


def test_a_scene_without_curves_is_its_background(engine):
    scene, target = scene_and_target(curves=1)
    for name in ("points", "colours", "opacities", "half_widths"):
        setattr(scene, name, getattr(scene, name)[:0])
    assert torch.allclose(engine.render(scene, RELAXED), torch.tensor(PAPER).expand(37, 45, 3))
    loss, _ = engine.gradients(scene, RELAXED, target=target)
    assert loss == pytest.approx(float((torch.tensor(PAPER) - target).square().sum()), rel=1e-5)


def test_a_replayed_step_is_the_direct_one(engine):
    """Every other step is given copies, which forgets what was captured; the values of each step reach the replays."""
    results = []
    for copying in (False, True):
        driver = EmulatedDriver()
        own = CudaEngine(driver=driver)
        scene, target = scene_and_target()
        scene.logits, state, losses = True, state_for(scene), []
        for i in range(6):
            if copying:
                scene, state = packed(scene), state.copy()
            settings = RasterSettings("relaxed", 3.0 - 0.4 * i, 8)
            training = Training(target, state, Rates(0.2 + 0.05 * i, 0.05, 0.05, 0.0))
            losses.append(float(own.step(scene, settings, training)))
        captured = [plan.replay is not None for plan in own._plans.values()]
        assert captured == ([False, False] if copying else [True])
        results.append((losses, scene.points, scene.colours, state.moments))
    assert results[0][0] == results[1][0]
    for direct, replayed in zip(results[0][1:], results[1][1:], strict=True):
        assert torch.equal(direct, replayed)


def test_curves_may_be_replaced_in_place_between_replays(engine):
    scene, target = scene_and_target()
    cpu, there = CpuEngine(1), packed(scene)
    states = state_for(there), state_for(scene)
    for i in range(6):
        if i == 3:
            other, _ = scene_and_target(seed=9)
            for tensors, state in ((scene, states[1]), (there, states[0])):
                tensors.points.copy_(other.points)
                state.moments.zero_()
                state.ages.zero_()
        rates = Rates(0.3, 0.02, 0.02, 0.0)
        want = cpu.step(there, RELAXED, Training(target, states[0], rates))
        got = float(engine.step(scene, RELAXED, Training(target, states[1], rates)))
        assert got == pytest.approx(want, rel=2e-3)
    assert engine._plans[next(reversed(engine._plans))].replay is not None


def test_two_phases_stay_captured_side_by_side():
    own = CudaEngine(driver=EmulatedDriver())
    scene, target = scene_and_target()
    state = state_for(scene)
    for settings in (RELAXED, EXACT, RELAXED, EXACT, RELAXED):
        own.step(scene, settings, Training(target, state, Rates(0.1, 0.01, 0.01, 0.0)))
    assert [plan.replay is not None for plan in own._plans.values()] == [True, True]
    own.close()
    assert not own._plans


def test_no_memory_names_the_size_and_the_way_out(engine, monkeypatch):
    def refuse(*_, **__):
        raise RuntimeError("CUDA out of memory. Tried to allocate 20.00 GiB.")

    scene, _ = scene_and_target(width=300, height=200)
    monkeypatch.setattr(torch, "empty", refuse)
    with pytest.raises(EngineError, match=r"no room for the picture \(1 MB more\); lower --curves, --samples"):
        engine.render(scene, RELAXED)


def test_a_large_scene_fits_into_half_a_gigabyte():
    """32,768 closed curves at 2040 x 1344: everything a fit holds on the GPU."""
    curves, points, pixels = 32768, 12, 2040 * 1344
    scene = packed(random_scene(Mode.CLOSED, 1, 4, background=PAPER))
    scene.width, scene.height = 2040, 1344
    scene.points = torch.empty(curves, points, 2, device="meta")
    for samples in (12, 24):
        frame = StepFrame(**sizes_of(scene, RasterSettings("relaxed", 1.0, samples, 0.05)), backward=True)
        buffers = workspace(frame, MOST_LOOKS, lambda _, count, dtype: torch.empty(count, dtype=dtype, device="meta"))
        taken = sum(t.numel() * t.element_size() for t in buffers.values())
        parameters = 4 * curves * (2 * points + 3 + 1 + 1 + 1)
        optimiser = 4 * curves * ((2 * points + 5) * 4 + 4 + 1)
        pictures = 2 * 3 * 4 * pixels  # target, and the picture for re-seeding
        assert taken + parameters + optimiser + pictures < 300e6


@pytest.mark.parametrize(
    ("kernel", "message"),
    [
        ("divergent_barrier", r"from thread 0 on __syncthreads at kernels.cpp:\d+; from thread 40 on done"),
        ("divergent_vote", r"from thread 0 on vote at .*; from thread 8 on done"),
        ("two_places", r"from thread 0 on vote at .*; from thread 1 on __syncwarp at"),
        ("partial_mask", "only whole warps are emulated"),
        ("unheard_of", "cannot launch unheard_of"),
    ],
)
def test_the_emulator_finds_misused_barriers(kernel, message):
    with pytest.raises(AssertionError, match=message):
        EmulatedDriver().kernels(Program(Mode.CLOSED, 3)).launch(kernel, (1, 1), 64, 0, StepFrame())


def test_the_order_of_threads_brings_out_a_missing_barrier():
    seen = set()
    for order in range(8):
        status = torch.zeros(32, dtype=torch.int32)
        kernels = EmulatedDriver(order=order).kernels(Program(Mode.CLOSED, 3))
        kernels.launch("missing_barrier", (1, 1), 64, 4 * 64, StepFrame(status=status.data_ptr()))
        seen.add(tuple(status.tolist()))
    assert (-1,) * 32 in seen, "shared memory starts as NaN, all bits set"
    assert tuple(range(32, 64)) in seen


def emulated_engine(*_, **__):
    return CudaEngine(driver=EmulatedDriver())


@pytest.mark.slow
@pytest.mark.parametrize("fill", rest_slow("linear", "flat"))
def test_a_fit_on_the_emulator_is_as_good_as_on_the_cpu(fill):
    """A whole fit with the CUDA engine in the CPU engine's place, exact finish included."""
    target = random_target(random_scene(Mode.CLOSED, 1, 3, 40, 32, background=PAPER), 4).numpy()
    levels = []
    for name, opened in (("cpu", open_engine), ("cuda", emulated_engine)):
        settings = FitSettings.from_preset("draft", curves=16, steps=60, threads=1, fill=fill)
        result = FitLoop(target, settings, opened=opened).finish()
        assert result.steps == 60
        assert result.device["name"] == name
        levels.append(result.history[-1]["psnr_db"])
    assert levels[0] > 20.0
    assert abs(levels[1] - levels[0]) < 0.6  # 60 chaotic steps


def test_a_fit_on_the_emulator_changes_its_size_and_its_number_of_curves():
    """On one engine, whose steps are counted on."""
    target = random_target(random_scene(Mode.CLOSED, 1, 3, 40, 32, background=PAPER), 4).numpy()
    loop = FitLoop(
        target[::2, ::2].copy(), FitSettings.from_preset("draft", curves=6, steps=40), opened=emulated_engine
    )
    assert loop.relax(0.5)
    loop.resize(np.argsort(-loop.importance())[:4], 9)
    assert loop.relax()
    loop.go_over_to(target, FitInputs())
    result = loop.finish()
    assert (result.steps, result.scene.width, result.scene.height) == (40, 40, 32)
    assert result.scene.curves + result.dropped == 9
    assert result.history[-1]["psnr_db"] > result.history[0]["psnr_db"] + 1.0


def test_a_fit_that_breaks_down_names_curve_and_step():
    """By what the engine has noted, which the loop reads some steps later."""
    target = random_target(random_scene(Mode.CLOSED, 1, 3, 24, 20, background=PAPER), 4)
    fit_loop = FitLoop(target, FitSettings.from_preset("draft", curves=8, steps=200), opened=emulated_engine)
    for _ in range(20):
        fit_loop.advance()
    fit_loop.state.curves.points[5, 2, 0] = float("nan")
    with pytest.raises(EngineError, match=r"at step 20: curve 5 has a non-finite value; lower the step sizes"):
        for _ in range(40):
            fit_loop.advance()
    assert fit_loop.step > 20, "nothing waited for the step that did it"


ASAN_PROGRAM = """
import ctypes, sys
sys.path[:0] = {paths!r}
import torch
from emulated import EmulatedDriver
from engines import packed, state_for
from scenes import PAPER, ragged_scene, random_scene, random_target
from cubicsplat_cli.raster.engine import Rates, Training
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.frame import StepFrame
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode

driver = EmulatedDriver(extra=("-fsanitize=address", "-g"))
engine = CudaEngine(driver=driver)
for mode in Mode:
    for background in (PAPER, None):
        for curves, width, height, samples in ((40, 33, 19, 12), (520, 17, 18, 4), (3, 1, 1, 64), (2100, 9, 9, 2)):
            scene = random_scene(mode, curves, 3, width, height, 1, background=background, scale=0.3)
            here, target = packed(scene), random_target(scene)
            here.logits = True
            for coverage, tolerance in (("relaxed", 0.0), ("exact", 0.05)):
                settings = RasterSettings(coverage, 1.0, samples, tolerance)
                engine.gradients(here, settings, target=target, importance="loo")
                engine.step(here, settings, Training(target, state_for(here), Rates(0.1, 0.1, 0.1, 0.1)))
    here, target = packed(ragged_scene(mode, 40, 33, 19, background=PAPER)), torch.zeros(19, 33, 3)
    for table in (here.ring_ends, torch.randint(-9, 99, here.ring_ends.shape, dtype=torch.int32)):
        here.ring_ends = table  # the second one holds no rings at all, and nobody has looked at it
        for coverage in ("relaxed", "exact"):
            settings = RasterSettings(coverage, 1.0, 12, 0.05)
            engine.step(here, settings, Training(target, state_for(here), Rates(0.1, 0.1, 0.1, 0.1)))
print("clean", flush=True)
status = torch.zeros(2, dtype=torch.int32)
driver.kernels(Program(Mode.CLOSED, 3)).launch("past_the_end", (1, 1), 32, 0, StepFrame(status=status.data_ptr()))
print("not found")
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="preloads the sanitizer's library")
def test_no_access_outside_of_buffers():
    """Under AddressSanitizer; at the end a write past the end of a buffer shows that it is awake."""
    command = [compiler() or "", "-print-file-name=libasan.so"]
    library = subprocess.run(command, capture_output=True, text=True, check=True).stdout.strip()
    if not Path(library).is_absolute():
        pytest.skip("the compiler has no AddressSanitizer")
    here = Path(__file__).parent
    program = ASAN_PROGRAM.format(paths=[str(here)])
    environment = os.environ | {"LD_PRELOAD": library, "ASAN_OPTIONS": "detect_leaks=0:detect_stack_use_after_return=0"}
    done = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False, env=environment, timeout=1500
    )
    assert "clean" in done.stdout, done.stderr[-3000:]
    assert "not found" not in done.stdout
    # What lies behind the buffer may have been freed.
    assert re.search("AddressSanitizer: heap-(buffer-overflow|use-after-free)", done.stderr), done.stderr[-6000:]
