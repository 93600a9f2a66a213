"""The engines that the tests run on, each under one name; and comparing them with the reference, all the same way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import pytest
import reference
import torch
from emulated import EmulatedDriver, compiler
from emulated_arm import ArmEngine, missing
from scenes import DEGENERATE, PAPER, TENSORS, in_double, random_target
from torch import Tensor

from cubicsplat_cli.raster.cpu import CpuEngine, instruction_sets
from cubicsplat_cli.raster.cuda.engine import CudaEngine
from cubicsplat_cli.raster.engine import Engine, EngineScene, OptimiserState
from cubicsplat_cli.raster.engines import render_scene, scene_arrays
from cubicsplat_cli.raster.settings import FLATNESS, RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode

PICTURE_TOLERANCE = 2e-4  # of a value in [0, 1], away from edges that rounding can put on the other side of a centre
GRADIENT_TOLERANCE = 2e-3  # of the largest gradient of its kind
FLIPPED = 0.004  # fraction of values that may differ more: signs and nearest edges that rounding decides
# What every engine is compared in.
SETTINGS = [
    RasterSettings("relaxed", 4.0, 6),
    RasterSettings("relaxed", 1.0, 12),
    RasterSettings("exact", 1.0, 24),
]
NAMES = [f"{s.coverage}-{s.edge_width:g}" for s in SETTINGS]
RELAXED, EXACT = RasterSettings("relaxed", 1.0, 8), RasterSettings("exact", 1.0, 16)
CASES = [(mode, background) for mode in Mode for background in (PAPER, None)]
CASE_NAMES = [f"{mode.value}-{'rgb' if background else 'rgba'}" for mode, background in CASES]

FIRST, *OTHERS = instruction_sets()
MARKS = {
    "emulated": pytest.mark.skipif(compiler() is None, reason="needs a C++ compiler"),
    "gpu": pytest.mark.gpu,
    "arm": [pytest.mark.slow, pytest.mark.skipif(bool(missing()), reason=f"needs {', '.join(missing())}")],
}


def _case(kind: str, *values: object, name: str = "") -> object:
    return pytest.param(kind, *values, marks=MARKS.get(kind, ()), id=f"{kind}-{name}" if name else kind)


CUDA = [_case("emulated"), _case("gpu")]
# The CPU's other instruction sets, whose code is the same, are fast tests of `WITH_SETTINGS` alone.
REST = [pytest.param(kind, marks=pytest.mark.slow, id=kind) for kind in OTHERS]
ENGINES = [_case(FIRST), *REST, _case("arm"), *CUDA]
on_cpu_and_gpu = pytest.mark.parametrize("engine", [ENGINES[0], *CUDA], indirect=True)
PAINT = ("colours", "opacities")


def _representative(kind: str) -> list[RasterSettings]:
    """All settings on the best CPU engines and on a GPU; of the others, whose code is the same, one that tells most.

    The emulated GPU has a kernel for either coverage.
    """
    if kind in (FIRST, "arm", "gpu"):
        return SETTINGS
    return SETTINGS[1:] if kind == "emulated" else SETTINGS[2:]


KINDS = (FIRST, *OTHERS, "arm", "emulated", "gpu")
WITH_SETTINGS = [_case(k, s, name=NAMES[SETTINGS.index(s)]) for k in KINDS for s in _representative(k)]


def _degenerate_cases() -> list[object]:
    """Every scene in settings taken in turn, other ones over a background than without: two of the three on a GPU, so
    that each kind of scene meets all of them there, and one elsewhere. The CPU's other instruction sets, whose code is
    the same, get every third scene.
    """
    cases = []
    for i, (name, scene) in enumerate(DEGENERATE):
        first = i + (scene.background is None)
        for kind in KINDS:
            if kind in OTHERS and (i + OTHERS.index(kind)) % 3:
                continue
            turns = range(first, first + (2 if kind == "gpu" else 1))
            chosen = [SETTINGS[turn % len(SETTINGS)] for turn in turns]
            cases += [_case(kind, name, scene, s, name=f"{name}-{NAMES[SETTINGS.index(s)]}") for s in chosen]
    return cases


DEGENERATE_CASES = _degenerate_cases()


def with_cases(engines: Sequence[Any]) -> list[Any]:
    """(engine, mode, background) of all engines and cases. Of the emulated GPU, for which each case is a program of its
    own to compile, one is a fast test.
    """
    made = []
    for (mode, background), name in zip(CASES, CASE_NAMES, strict=True):
        for engine in engines:
            rare = engine.id == "emulated" and (mode, background) != (Mode.OPEN, None)
            marks = [*engine.marks, *[pytest.mark.slow] * rare]
            made.append(pytest.param(*engine.values, mode, background, marks=marks, id=f"{name}-{engine.id}"))
    return made


def open_cuda(kind: str, **options) -> CudaEngine:
    """The CUDA engine on the emulator or on the real device. options: of `EmulatedDriver`."""
    if kind == "gpu":
        if not torch.cuda.is_available():
            pytest.skip("needs a CUDA device")
        return CudaEngine()
    return CudaEngine(driver=EmulatedDriver(**options))


def open_kind(kind: str) -> Engine:
    """The engine of a name: an instruction set, "arm" (emulated), "emulated" (a GPU) or "gpu"."""
    if kind == "arm":
        return ArmEngine(2, "neon")
    return open_cuda(kind) if kind in MARKS else CpuEngine(2, kind)


@dataclass
class Truth:
    """What the float64 reference says of a scene: picture, loss and gradients."""

    image: Tensor
    loss: float
    gradients: dict[str, Tensor]


def truth(scene: Scene, settings: RasterSettings, target: Tensor, names: Sequence[str] = TENSORS) -> Truth:
    """Reference picture and the gradients of the squared error against `target`, for the tensors of these names."""
    leaves = in_double(scene, requires_grad=True)
    for name in set(TENSORS).difference(names):  # spares the reference the long way back through an exact coverage
        getattr(leaves, name).requires_grad_(False)
    image = reference.render(leaves, settings)
    loss = reference.image_loss(image, target.double())
    loss.backward()
    given = {name: getattr(leaves, name) for name in names}
    gradients = {name: torch.zeros_like(t) if t.grad is None else t.grad for name, t in given.items()}
    return Truth(image.detach(), float(loss.detach()), gradients)


def packed(scene: Scene, device: torch.device | str = "cpu") -> EngineScene:
    """A copy of a scene's tensors on a device."""
    return scene_arrays(scene).changed(lambda t: torch.from_numpy(t).to(device, copy=True))


def state_for(scene: EngineScene) -> OptimiserState:
    """An empty optimiser state beside the scene's tensors."""
    return OptimiserState.zeros_for(scene.points)


def outliers(got: Tensor, want: Tensor, tolerance: float) -> float:
    """Fraction of the values that differ by more than the tolerance."""
    if want.numel() == 0:
        return 0.0
    return float(((got.cpu().double() - want).abs() > tolerance).double().mean())


def close(got: Tensor, want: Tensor, tolerance: float, share: float = 0.0) -> bool:
    """Whether all values but a share differ by at most the tolerance times the largest wanted one (or 1e-6)."""
    got, want = got.detach().cpu().double(), want.detach().cpu().double()
    assert got.shape == want.shape
    assert torch.isfinite(got).all()
    if want.numel() == 0:
        return True
    return outliers(got, want, tolerance * max(float(want.abs().max()), 1e-6)) <= share


def compared(scene: Scene) -> list[str]:
    """Parameters whose gradients are compared: half-widths only where there are strokes."""
    return [name for name in TENSORS if name != "half_widths" or scene.mode is Mode.OPEN]


def assert_same(engine: Engine, got: dict[str, Tensor], want: dict[str, Tensor]) -> None:
    """Equal to the bit; but on a GPU atomics add in any order."""
    for name, value in want.items():
        on_gpu = str(engine.device).startswith("cuda")
        assert close(got[name], value, 1e-4) if on_gpu else torch.equal(got[name], value), name


def assert_degenerate_like(want: Truth, engine: Engine, scene: Scene, settings: RasterSettings) -> None:
    """Picture and gradients of the paint are the reference's, and all gradients finite."""
    here, target = packed(scene, engine.device), random_target(scene).to(engine.device)
    image = engine.render(here, settings)
    assert torch.isfinite(image).all()
    assert outliers(image, want.image, 2e-3) <= 0.02
    _, got = engine.gradients(here, settings, target=target, importance="loo")
    for key, value in got.items():
        assert torch.isfinite(value).all(), key
    for key in PAINT:
        scale = max(1.0, float(want.gradients[key].abs().max()))
        assert outliers(got[key], want.gradients[key], 0.02 * scale) == 0.0, key


def assert_drawn_and_differentiated(engine: Engine, scene: Scene, leaves: dict[str, Tensor], picture: Tensor) -> None:
    """The operator's picture, in EXACT, and the gradients that it gave the leaves are the engine's; `render_scene`
    draws the same with as many edges as it takes.
    """
    assert torch.equal(picture.detach(), engine.render(packed(scene), EXACT))
    finished = engine.render(packed(scene), replace(EXACT, tolerance=FLATNESS))
    assert torch.equal(torch.from_numpy(render_scene(scene, samples=16)), finished)
    target = random_target(scene)
    (picture - target).square().sum().backward()
    _, got = engine.gradients(packed(scene), EXACT, target=target)
    for name, leaf in leaves.items():
        assert torch.allclose(leaf.grad, got[name], rtol=1e-4, atol=1e-3), name


def assert_like_cpu(
    engine: Engine, scene: EngineScene, settings, target: Tensor, share: float = 0.02, tolerance: float = 5e-4
) -> None:
    """Picture (up to `tolerance`), loss, every gradient and leave-one-out importance are those of the CPU engine."""
    cpu = CpuEngine(1)
    here = packed(scene, engine.device)
    picture = cpu.render(scene, settings)
    assert close(engine.render(here, settings), picture, tolerance, share / 5), "picture"
    loss, want = cpu.gradients(scene, settings, target=target, importance="loo")
    found, got = engine.gradients(here, settings, target=target.to(engine.device), importance="loo")
    assert found == pytest.approx(loss, rel=2e-3, abs=1e-4)
    assert set(got) == set(want)
    for name, value in want.items():
        assert close(got[name], value, 3e-3, share), name
    cpu.close()
