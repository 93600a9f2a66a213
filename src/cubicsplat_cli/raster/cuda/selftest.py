"""A test that this GPU, with its driver and compiler, computes a small scene as the CPU does."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import closing
from itertools import product

import torch
from torch import Tensor

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import Blunting, CpuEngine
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.engine import MOVED, Engine, EngineScene, OptimiserState, Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import points_from_segments
from cubicsplat_cli.scene.gradients import Gradients
from cubicsplat_cli.settings import Mode

WIDTH, HEIGHT = 22, 19
CURVES = 40  # more than a batch of the raster kernel holds
SEGMENTS = 2
STEPS = 3  # one launched, one captured and replayed, one replayed
RATES = Rates(0.5, 0.2, 0.2, 0.1, keep=(0.98, 0.92, 0.99), epsilon=1.0)
TOLERANCE = 5e-3
# The penalty on spikes and slivers with limits that joins and sides of these curves are beyond.
BLUNTING = {
    "turns": 0.2, "slivers": 0.02, "loss": 1.0, "turn": 0.4, "arm": 0.3, "thinnest": 6.0, "opposite": -0.5, "edges": 5,
    "every": 2,
}  # fmt: skip


def scene(program: Program, device: torch.device | str, *, logits: bool = False) -> EngineScene:
    """Return overlapping faint curves, some of them partly outside the canvas. logits: as a fit has them."""
    count = points_from_segments(program.mode, SEGMENTS)
    along = torch.arange(count) / count
    shapes = []
    for i in range(CURVES):
        if program.mode is Mode.CLOSED:
            # No side lies level, where rounding alone would decide on which side of it the shape is.
            turn = 2.0 * math.pi * along + 0.7 * i + 0.2
            shape = torch.stack((5.0 * turn.cos(), 4.0 * turn.sin()), -1)
        else:
            shape = torch.stack((12.0 * along - 6.0, 4.0 * (5.0 * along + i).sin()), -1)
        shapes.append(shape + torch.tensor([(5.3 + 6.1 * i) % WIDTH, (4.2 + 4.7 * i) % HEIGHT]))
    curves = torch.arange(CURVES)
    colours = 0.5 + 0.4 * (curves[:, None] + torch.tensor([0.3, 1.1, 2.3])).sin()
    opacities = 0.15 + 0.1 * curves.sin()
    half_widths = 1.4 + 0.4 * curves.cos() if program.mode is Mode.OPEN else torch.zeros(CURVES)
    background = (0.9, 0.85, 0.7) if program.channels == 3 else None
    given = (torch.stack(shapes), colours, opacities, half_widths)
    points, colours, opacities, half_widths = (t.float().contiguous().to(device) for t in given)
    fills = gradients(device) if program.painted else None
    size = program.mode, WIDTH, HEIGHT
    return EngineScene(*size, points, colours, opacities, half_widths, background, gradients=fills, logits=logits)


def gradients(device: torch.device | str) -> Gradients:
    """Return flat fills, linear gradients, and radial ones with a focus in turn, of one to three stops."""
    curves = torch.arange(CURVES)
    turn = 0.9 * curves[:, None, None] + torch.tensor([[0.0, 1.6], [1.6, 3.1]])
    plane = 0.06 * (turn.cos() + torch.eye(2))
    shift = 0.4 - plane @ torch.stack(((5.3 + 6.1 * curves) % WIDTH, (4.2 + 4.7 * curves) % HEIGHT), -1)[..., None]
    offsets = torch.stack((0.1 + 0.0 * curves, 0.4 + 0.1 * curves.sin(), 0.9 + 0.1 * curves.cos()), 1)
    stops = 0.5 + 0.45 * (curves[:, None, None] + 1.7 * torch.arange(12).view(3, 4)).sin()
    kinds, counts = curves % 3, 1 + curves // 3 % 3
    lean = 0.4 * torch.stack((curves.cos(), curves.sin()), 1)[..., None]
    floats = (t.float().contiguous().to(device) for t in (torch.cat((plane, shift, lean), 2), offsets, stops))
    frames, offsets, stops = floats
    return Gradients(kinds.int().to(device), frames, counts.int().to(device), offsets, stops)


def target(program: Program, device: torch.device | str) -> Tensor:
    """Return a smooth picture (H, W, C)."""
    y, x = torch.meshgrid(torch.arange(HEIGHT) / HEIGHT, torch.arange(WIDTH) / WIDTH, indexing="ij")
    planes = [0.5 + 0.4 * (3.0 * x + 2.0 * y + c).sin() for c in range(program.channels)]
    return torch.stack(planes, -1).float().contiguous().to(device)


def settings(coverage: str) -> RasterSettings:
    return RasterSettings(coverage, 1.3, 5)


def _digest(loss: float, values: list[Tensor]) -> tuple[float, ...]:
    """Return a few numbers that any mistake changes: sums with weights that differ from value to value."""
    weighted = []
    for value in values:
        flat = value.detach().double().cpu().reshape(-1)
        weighted.append(float(flat @ torch.arange(1, flat.numel() + 1).double().mul(0.7).cos()))
    return loss, *weighted


def _drawn(engine: Engine, program: Program, coverage: str) -> tuple[float, ...]:
    small, wanted = scene(program, engine.device), target(program, engine.device)
    image = engine.render(small, settings(coverage))
    loss, gradients = engine.gradients(small, settings(coverage), target=wanted, importance="loo")
    strokes, fills = ["half_widths"] * (program.mode is Mode.OPEN), ["frames", "stops"] * program.painted
    names = ["points", "colours", "opacities", *strokes, *fills, "importance"]
    return _digest(loss, [image, *(gradients[name] for name in names)])


def _trained(engine: Engine, program: Program, coverage: str) -> tuple[float, ...]:
    start, small = (scene(program, engine.device, logits=True) for _ in range(2))
    gradient = torch.empty_like(small.points)
    training = Training(
        target(program, engine.device), OptimiserState.zeros_for(small.points), RATES,
        blunting=Blunting(**BLUNTING, gradient=gradient.data_ptr()),
    )  # fmt: skip
    for _ in range(STEPS):
        training.blunting.loss = 1.0
        loss = engine.step(small, settings(coverage), training)
    return _digest(float(loss), [getattr(small, name) - getattr(start, name) for name in MOVED[:4]])


def numbers(engine: Engine, program: Program) -> Iterator[tuple[str, tuple[float, ...]]]:
    """Yield what an engine computes of the scene, in each coverage: pictures with gradients, and training steps."""
    # With gradient fills a step does nothing else.
    cases = [("gradients", _drawn)] + [("training", _trained)] * (not program.painted)
    for coverage, (doing, of) in product(("relaxed", "exact"), cases):
        yield f"{coverage} {doing}", of(engine, program, coverage)


def self_test(engine: Engine, program: Program) -> None:
    """Raise EngineError if the engine's numbers are not the CPU's: pictures, gradients, training steps."""
    with closing(CpuEngine(1)) as cpu:
        for (doing, found), (_, expected) in zip(numbers(engine, program), numbers(cpu, program), strict=True):
            for value, right in zip(found, expected, strict=True):
                if not abs(value - right) <= TOLERANCE * (1.0 + abs(right)):
                    text = f"self-test ({program.name}, {doing}) gives {value:.6g} in place of {right:.6g}"
                    reason = "the GPU, its driver or its compiler is broken; use --device cpu"
                    raise EngineError(f"the CUDA engine's {text}: {reason}")
