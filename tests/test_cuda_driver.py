"""`CudaDriver` between stand-ins for NVIDIA's library and for torch's graphs: launches, contexts, errors."""

from __future__ import annotations

import pytest
from cuda_stand_in import CONTEXT, OTHER_STREAM, FakeEvent, install, on_the_cpu
from emulated import compiler
from engines import packed, state_for
from scenes import PAPER, random_scene, random_target

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.cuda import libcuda
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.driver import CudaDriver, cuda_driver
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.cuda.frame import carve_out
from cubicsplat_cli.raster.engine import Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode

pytestmark = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")
SETTINGS, RATES = RasterSettings("relaxed", 1.5, 8), Rates(0.2, 0.02, 0.02, 0.01)
STROKES = Program(Mode.OPEN, 3)
KERNELS = ("flatten", "raster_relaxed", "update")


@pytest.fixture
def gpu(monkeypatch):
    return install(monkeypatch)


@pytest.fixture
def engine(gpu):
    driver = on_the_cpu(CudaDriver())
    driver.tested.add(STROKES)  # a test of its own shows that a driver is tested
    engine = CudaEngine(program=STROKES, driver=driver)
    gpu.calls.clear()
    return engine


def prepared(seed=1):
    scene = random_scene(Mode.OPEN, 9, 2, 30, 26, background=PAPER)
    here = packed(scene)
    return here, random_target(scene, seed), state_for(here)


def test_steps_go_through_the_driver_and_its_graphs(gpu, engine):
    here, target, state = prepared()
    there, _, cpu_state = prepared()
    for _ in range(4):
        got = float(engine.step(here, SETTINGS, Training(target, state, RATES)))
        assert got == pytest.approx(CpuEngine(1).step(there, SETTINGS, Training(target, cpu_state, RATES)), rel=1e-3)
    steps = [call for call in gpu.calls if call != ("set_step", "run")]
    wanted = [(name, "run") for name in KERNELS] + [(name, "captured") for name in KERNELS]
    assert steps == wanted + 3 * [("graph", "replayed")]
    assert engine.describe()["gpu"] == "Pretender"


@pytest.mark.parametrize("stack", [[], [CONTEXT], [5], [CONTEXT, 5]], ids=["none", "own", "foreign", "above"])
def test_any_context_may_be_current(gpu, engine, stack):
    """A new thread has none; another library may have entered one of its own. Both find what they left."""
    gpu.contexts = list(stack)
    here, target, state = prepared()
    engine.step(here, SETTINGS, Training(target, state, RATES))
    assert gpu.contexts == stack


def test_engines_share_one_driver_with_its_programs(gpu):
    driver = cuda_driver()
    on_the_cpu(driver)
    assert cuda_driver(0) is driver
    for _ in range(3):
        CudaEngine(program=STROKES)
    assert gpu.loads == [STROKES], "loaded once in a process"
    tests = len(gpu.calls)
    CudaEngine(program=STROKES)
    assert len(gpu.calls) == tests, "tested once in a process"


def test_every_stream_has_buffers_of_its_own(gpu, engine):
    here, target, state = prepared()
    for stream in (None, OTHER_STREAM):
        if stream:
            gpu.streams.append(stream)
        engine.step(here, SETTINGS, Training(target, state, RATES))
    first, second = engine._plans.values()
    assert first.workspace.edges.data_ptr() != second.workspace.edges.data_ptr()


def test_a_failed_launch_is_said(gpu, engine):
    gpu.launch_errors = [700]
    scene, _, _ = prepared()
    with pytest.raises(EngineError, match="GPU failed while starting the kernel set_step: CUDA_ERROR_ILLEGAL_ADDRESS"):
        engine.render(scene, RasterSettings())
    gpu.launch_errors = [999]
    with pytest.raises(EngineError, match="GPU failed while starting the kernel set_step: error 999"):
        engine.render(scene, RasterSettings())


def test_a_launch_that_fails_in_a_capture_is_the_one_that_is_said(gpu, engine):
    here, target, state = prepared()
    engine.step(here, SETTINGS, Training(target, state, RATES))
    gpu.launch_errors = [0, 700]
    with pytest.raises(EngineError, match="while starting the kernel flatten: CUDA_ERROR_ILLEGAL_ADDRESS"):
        engine.step(here, SETTINGS, Training(target, state, RATES))
    assert gpu.captured is None


def test_what_torch_says_of_a_lost_gpu_is_an_error_of_the_engine(gpu, engine):
    def lost():
        raise RuntimeError("CUDA error: unspecified launch failure\nCompile with `TORCH_USE_CUDA_DSA`")

    here, target, state = prepared()
    for _ in range(2):
        engine.step(here, SETTINGS, Training(target, state, RATES))
    (plan,) = engine._plans.values()
    plan.replay = lost
    with pytest.raises(EngineError, match=r"the GPU failed: CUDA error: unspecified launch failure Compile .* --dev"):
        engine.step(here, SETTINGS, Training(target, state, RATES))
    with pytest.raises(EngineError, match="the GPU failed: CUDA error"), engine.guarded():
        lost()


def test_faults_are_seen_without_waiting(gpu, engine):
    here, target, state = prepared()
    assert engine.fault(wait=False) is None
    engine.step(here, SETTINGS, Training(target, state, RATES))
    here.points[3, 1, 0] = float("nan")
    engine.step(here, SETTINGS, Training(target, state, RATES))
    FakeEvent.done = False
    try:
        assert engine.fault(wait=False) is None, "the copy is on its way"
    finally:
        FakeEvent.done = True
    assert engine.fault(wait=False) is None, "the copy was made before the step"
    assert engine.fault(wait=False) == engine.fault() == (3, 1)
    engine.close()
    assert engine.fault() is None, "closing forgets it"


def test_raster_kernels_ask_for_shared_memory(gpu, engine):
    scene, _, _ = prepared()
    for coverage in ("relaxed", "exact"):
        engine.render(scene, RasterSettings(coverage, 1.0, 8))
    assert set(gpu.hints) == {"raster_relaxed", "raster_exact"}
    # Four blocks of 26 KB and three of 46 KB beside what the system keeps for itself.
    assert 40 < gpu.hints["raster_relaxed"] < gpu.hints["raster_exact"] <= 100
    assert carve_out("raster_exact", 47 * 1024, 100 * 1024) == 100


def test_what_goes_wrong_at_the_start_is_said(gpu):
    gpu.failing["cuModuleLoadData"] = 222
    with pytest.raises(EngineError, match=r"loading the kernels \(is the driver too old\?\): CUDA_ERROR_UNSUPP"):
        CudaDriver().kernels(STROKES)
    gpu.version = 12040
    with pytest.raises(EngineError, match=r"driver is too old: it supports CUDA 12, the compiler is for CUDA 13"):
        CudaDriver()

    gpu.out_of_memory = {"synchronize"}
    with pytest.raises(EngineError, match="cuda:0 cannot be used: CUDA error: out of memory Compile"):
        CudaDriver(0)
    gpu.out_of_memory = {"current_device"}
    for opened in (CudaDriver, cuda_driver):
        with pytest.raises(EngineError, match="the current GPU cannot be used: CUDA error: out of memory Compile"):
            opened()


def test_a_machine_without_the_library():
    with pytest.raises(EngineError, match=r"library libcuda\.so\.none cannot be loaded \(.*libcuda\.so\.none.*install"):
        libcuda.open_library("libcuda.so.none")
