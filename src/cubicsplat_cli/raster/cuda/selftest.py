"""Does this GPU, with this driver and compiler, compute what it should? A tiny scene, before a program's first use.

The expected numbers are the float64 reference's; tests/test_cuda_device.py recomputes them.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.engine import Engine, SceneTensors
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import points_from_segments
from cubicsplat_cli.settings import Mode

WIDTH, HEIGHT = 22, 19
SEGMENTS = 2
TOLERANCE = 5e-3
COVERAGES = ("relaxed", "exact")

# (mode, channels, coverage): loss, weighted sum of the picture, and of the gradients of points, colours, opacities
# and (strokes) half-widths.
EXPECTED: dict[tuple[Mode, int, str], tuple[float, ...]] = {
    (Mode.CLOSED, 3, "relaxed"): (181.79, -1.83752, -4.41829, 71.307, 21.7566),
    (Mode.CLOSED, 3, "exact"): (184.438, -2.25309, -4.58036, 71.1561, 21.7643),
    (Mode.CLOSED, 4, "relaxed"): (356.664, 0.177381, -1.89714, 90.2225, 25.9772),
    (Mode.CLOSED, 4, "exact"): (359.37, 0.695249, -2.11044, 91.2337, 26.0875),
    (Mode.OPEN, 3, "relaxed"): (194.504, -2.27187, -0.198964, 75.512, 4.22303, 4.35682),
    (Mode.OPEN, 3, "exact"): (198.702, -1.99163, -0.255351, 77.3445, 4.17261, 4.30474),
    (Mode.OPEN, 4, "relaxed"): (366.427, -0.450273, 0.482953, 85.0673, 8.75546, -0.233356),
    (Mode.OPEN, 4, "exact"): (371.53, -0.600606, 0.336584, 86.9477, 9.06559, -0.298909),
}


def scene(program: Program, device: torch.device | str = "cpu") -> SceneTensors:
    """Three overlapping curves, one of them partly outside the canvas."""
    count = points_from_segments(program.mode, SEGMENTS)
    along = torch.arange(count) / count
    shapes = []
    for i in range(3):
        if program.mode is Mode.CLOSED:
            turn = 2.0 * math.pi * along + 0.7 * i
            shape = torch.stack((7.0 * turn.cos(), 6.0 * turn.sin()), -1)
        else:
            shape = torch.stack((16.0 * along - 8.0, 5.0 * (5.0 * along + i).sin()), -1)
        shapes.append(shape + torch.tensor([5.3 + 5.1 * i, 6.2 + 3.4 * i]))
    colours = torch.tensor([[0.9, 0.2, 0.1], [0.1, 0.7, 0.3], [0.2, 0.3, 0.8]])
    half_widths = torch.full((3,), 1.4) if program.mode is Mode.OPEN else torch.zeros(3)
    background = (0.9, 0.85, 0.7) if program.channels == 3 else None
    tensors = (torch.stack(shapes), colours, torch.tensor([0.5, 0.7, 0.9]), half_widths)
    return SceneTensors(program.mode, WIDTH, HEIGHT, *(t.float().to(device) for t in tensors), background)


def target(program: Program, device: torch.device | str = "cpu") -> Tensor:
    """A smooth picture (H, W, C)."""
    y, x = torch.meshgrid(torch.arange(HEIGHT) / HEIGHT, torch.arange(WIDTH) / WIDTH, indexing="ij")
    planes = [0.5 + 0.4 * (3.0 * x + 2.0 * y + c).sin() for c in range(program.channels)]
    return torch.stack(planes, -1).float().contiguous().to(device)


def settings(coverage: str) -> RasterSettings:
    return RasterSettings(coverage, 1.3, 5)


def digest(program: Program, image: Tensor, loss: float, gradients: dict[str, Tensor]) -> tuple[float, ...]:
    """A few numbers that any mistake changes: sums with weights that differ from value to value."""
    names = ["points", "colours", "opacities"] + ["half_widths"] * (program.mode is Mode.OPEN)
    values = [image, *(gradients[name] for name in names)]
    weighted = []
    for value in values:
        flat = value.detach().double().cpu().reshape(-1)
        weighted.append(float(flat @ torch.arange(1, flat.numel() + 1).double().mul(0.7).cos()))
    return loss, *weighted


def self_test(engine: Engine, program: Program) -> None:
    """Raises EngineError where the engine's numbers are not the expected ones."""
    tiny, wanted = scene(program, engine.device), target(program, engine.device)
    for coverage in COVERAGES:
        image = engine.render(tiny, settings(coverage))
        loss, gradients = engine.gradients(tiny, settings(coverage), target=wanted)
        got = digest(program, image, loss, gradients)
        expected = EXPECTED[program.mode, program.channels, coverage]
        for value, right in zip(got, expected, strict=True):
            if not abs(value - right) <= TOLERANCE * (1.0 + abs(right)):
                raise EngineError(
                    f"the CUDA engine's self-test ({program.name}, {coverage}) gives {value:.6g} in place of "
                    f"{right:.6g}: the GPU, its driver or its compiler is broken; use --device cpu"
                )
