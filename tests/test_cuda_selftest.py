"""An engine that does not compute what the CPU's does is not used."""

from __future__ import annotations

from contextlib import closing

import pytest
import torch
from conftest import rest_slow
from emulated import EmulatedDriver, compiler

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.cuda import selftest
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.settings import Mode

PROGRAMS = [Program(mode, channels, painted) for painted in (False, True) for mode in Mode for channels in (3, 4)]
needs_compiler = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")


@pytest.mark.parametrize("program", PROGRAMS, ids=lambda program: program.name)
def test_the_self_test_would_notice(program):
    """What it compares is far from nothing, so that a wrong sign or a missing step is outside of the tolerance."""
    with closing(CpuEngine(1)) as cpu:
        for _, values in selftest.numbers(cpu, program):
            assert all(abs(2.0 * value) > selftest.TOLERANCE * (1.0 + abs(value)) for value in values if value != 0.0)


class Rounding(CpuEngine):
    """Begins each step from control points that are off by what two devices' rounding makes of them."""

    def step(self, scene, settings, training):
        scene.points += 3e-6 * torch.randn(scene.points.shape, generator=torch.Generator().manual_seed(1))
        return super().step(scene, settings, training)


@pytest.mark.parametrize("program", PROGRAMS[:4], ids=lambda program: program.name)
def test_rounding_does_not_decide_the_self_test(program):
    with closing(Rounding(1)) as engine, closing(CpuEngine(1)) as cpu:
        assert list(selftest.numbers(engine, program)) != list(selftest.numbers(cpu, program))
        selftest.self_test(engine, program)  # which raises EngineError if the numbers are others


class Broken(EmulatedDriver):
    """A GPU of which one kernel does something else."""

    def __init__(self, broken: str) -> None:
        super().__init__()
        self.tested = set()
        self.broken = broken

    def _load(self, program):
        kernels = super()._load(program)
        launched = kernels.launch

        def launch(name, grid, threads, shared, *arguments):
            if name == "set_step" and self.broken == "drawing":
                arguments[0].edge_width *= 1.1
            if name == "set_step" and self.broken == "training":
                arguments[0].rates[0] *= 0.5
            launched(name, grid, threads, shared, *arguments)

        kernels.launch = launch
        return kernels

    def capture(self, body):
        return (lambda: None) if self.broken == "graphs" else super().capture(body)


@needs_compiler
def test_a_gpu_that_draws_wrongly_is_not_used():
    driver = Broken("drawing")
    for _ in range(2):
        with pytest.raises(
            EngineError, match=r"self-test \(open, RGBA, relaxed gradients\) gives .* in place of .*; use"
        ):
            CudaEngine(program=Program(Mode.OPEN, 4), driver=driver)
    driver.broken = ""
    engine = CudaEngine(program=Program(Mode.OPEN, 4), driver=driver)
    driver.broken = "drawing"
    assert CudaEngine(program=Program(Mode.OPEN, 4), driver=driver).name == "cuda", "tested once in a process"
    # A program loaded later is tested then, and stays untrusted.
    for _ in range(2):
        with pytest.raises(EngineError, match=r"self-test \(closed, RGB, relaxed gradients\)"):
            engine._load(Program(Mode.CLOSED, 3))


@needs_compiler
@pytest.mark.parametrize("broken", ["graphs", "training"])
def test_a_gpu_that_trains_wrongly_is_not_used(broken):
    with pytest.raises(EngineError, match=r"self-test \(open, RGB, relaxed training\)"):
        CudaEngine(program=Program(Mode.OPEN, 3), driver=Broken(broken))


@needs_compiler
@pytest.mark.parametrize(
    "program", rest_slow(PROGRAMS[1], PROGRAMS[-1], *PROGRAMS, fast=2), ids=lambda program: program.name
)
def test_only_the_program_in_use_is_compiled(program):
    driver = EmulatedDriver()
    driver.tested = set()
    CudaEngine(program=program, driver=driver)
    assert driver.tested == {program}
