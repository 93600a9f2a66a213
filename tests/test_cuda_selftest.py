"""The self-test expects what the float64 reference computes, and an engine that computes otherwise is not used."""

from __future__ import annotations

from itertools import product

import pytest
import reference
from adan import ReferenceFit
from conftest import rest_slow
from emulated import EmulatedDriver, compiler
from scenes import TENSORS
from torch import Tensor

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cuda import selftest
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode

PROGRAMS = [Program(mode, channels, painted) for painted in (False, True) for mode in Mode for channels in (3, 4)]
# Filled, stroked and painted, each in one kind of coverage; every program in one; all in both.
CASES = [(program, selftest.COVERAGES[i % 2]) for i, program in enumerate(PROGRAMS)]
CASES = rest_slow(CASES[0], CASES[3], CASES[5], *CASES, *product(PROGRAMS, selftest.COVERAGES), fast=3)
needs_compiler = pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler")


def drawn(program, coverage):
    """What the reference says of the self-test's scene."""
    scene, target = selftest.scene(program), selftest.target(program).double()
    leaves = {name: getattr(scene, name).double().requires_grad_() for name in TENSORS}
    gradients, fills = None, {}
    if scene.gradients is not None:
        gradients = scene.gradients.floating(Tensor.double)
        fills = {name: getattr(gradients, name).requires_grad_() for name in ("frames", "stops")}
    size = {"width": scene.width, "height": scene.height, "background": scene.background}
    scene, settings = Scene(program.mode, **size, **leaves, gradients=gradients), selftest.settings(coverage)
    image = reference.render(scene, settings)
    loss = reference.image_loss(image, target)
    loss.backward()
    found = {name: leaf.grad for name, leaf in (leaves | fills).items()}
    found["importance"] = reference.importance(scene, settings, target=target)
    return selftest.digest(float(loss.detach()), [image, *(found[name] for name in selftest.gradient_names(program))])


def trained(program, coverage):
    """How far the reference comes in the self-test's training steps."""
    start = selftest.untrained(program)
    fit = ReferenceFit(start, selftest.target(program), selftest.RATES)
    losses = [fit.step(selftest.settings(coverage)) for _ in range(selftest.STEPS)]
    return selftest.digest(losses[-1], [fit.values[name] - getattr(start, name) for name in selftest.TRAINED])


@pytest.mark.parametrize(("program", "coverage"), CASES)
def test_the_self_test_expects_what_the_reference_computes(program, coverage):
    key = (program.mode, program.channels, coverage)
    expected = selftest.EXPECTED_PAINTED if program.painted else selftest.EXPECTED
    assert drawn(program, coverage) == pytest.approx(expected[key], rel=1e-4, abs=1e-4)
    if not program.painted:
        assert trained(program, coverage) == pytest.approx(selftest.EXPECTED_STEPS[key], rel=1e-4, abs=1e-4)


def test_the_self_test_would_notice():
    """What it compares is far from nothing, so that a wrong sign or a missing step is outside of the tolerance."""
    for expected in (
        *selftest.EXPECTED.values(),
        *selftest.EXPECTED_PAINTED.values(),
        *selftest.EXPECTED_STEPS.values(),
    ):
        assert all(abs(2.0 * value) > selftest.TOLERANCE * (1.0 + abs(value)) for value in expected if value != 0.0)


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
