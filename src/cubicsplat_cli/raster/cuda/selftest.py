"""Does this GPU, with this driver and compiler, compute what it should? A small scene, before a program's first use.

The expected numbers are the float64 reference's; tests/test_cuda_selftest.py recomputes them.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.engine import Engine, EngineScene, OptimiserState, Rates, Training
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
COVERAGES = ("relaxed", "exact")
TRAINED = ("points", "colours", "opacities", "half_widths")

# (mode, channels, coverage): loss, weighted sums of the picture, of the gradients of points, colours, opacities and
# (strokes) half-widths, and of the leave-one-out importance.
EXPECTED: dict[tuple[Mode, int, str], tuple[float, ...]] = {
    (Mode.CLOSED, 3, "relaxed"): (156.871, -1.98084, 0.237312, 5.854, -62.82, 11.6528),
    (Mode.CLOSED, 3, "exact"): (157.688, -2.1866, 0.261923, 5.51571, -62.476, 11.6022),
    (Mode.CLOSED, 4, "relaxed"): (259.153, 0.217441, -0.139549, -0.699524, -129.106, 14.9883),
    (Mode.CLOSED, 4, "exact"): (259.747, -0.492332, -0.111462, -1.23828, -126.294, 14.6685),
    (Mode.OPEN, 3, "relaxed"): (163.044, -1.60495, 1.1742, -0.973057, -52.8005, -10.6903, 9.78459),
    (Mode.OPEN, 3, "exact"): (164.139, -1.53291, 1.17734, -0.92975, -51.7525, -10.7991, 9.56208),
    (Mode.OPEN, 4, "relaxed"): (257.897, -1.17633, -0.699511, -3.7952, -103.018, -10.5145, 11.4528),
    (Mode.OPEN, 4, "exact"): (259.124, -1.72238, -0.770784, -3.94963, -101.613, -10.7345, 11.214),
}
# The same of curves with gradients, with the weighted sums of the gradients of their frames and stops.
EXPECTED_PAINTED: dict[tuple[Mode, int, str], tuple[float, ...]] = {
    (Mode.CLOSED, 3, "relaxed"): (163.398, -1.80565, -0.459191, -4.26671, -69.0166, 29.2911, 15.2853, 15.2846),
    (Mode.CLOSED, 3, "exact"): (164.376, -1.88784, -0.438674, -4.18136, -68.147, 27.9985, 15.3348, 15.1593),
    (Mode.CLOSED, 4, "relaxed"): (276.197, 0.266544, -0.540583, -24.4458, -66.3418, -4.16729, 17.8191, 9.93802),
    (Mode.CLOSED, 4, "exact"): (276.78, -0.015283, -0.538028, -24.1184, -64.7437, -5.1689, 17.5482, 9.81183),
    (Mode.OPEN, 3, "relaxed"): (163.732, -1.89195, 0.860768, -6.37194, -57.016, -12.7622, 3.83072, 10.6899, 13.3778),
    (Mode.OPEN, 3, "exact"): (164.922, -2.23962, 0.854151, -6.28733, -55.6932, -12.9303, 2.3746, 10.7778, 13.1528),
    (Mode.OPEN, 4, "relaxed"): (275.35, -0.686248, 0.187, -28.6292, -39.3285, -4.58277, 3.68283, 26.2827, 5.44636),
    (Mode.OPEN, 4, "exact"): (276.41, -1.0996, 0.17749, -28.2784, -38.2673, -4.77442, 2.90103, 26.1657, 5.30485),
}
# The same: loss at the last of the training steps, and weighted sums of how far the parameters have come after it.
EXPECTED_STEPS: dict[tuple[Mode, int, str], tuple[float, ...]] = {
    (Mode.CLOSED, 3, "relaxed"): (103.502, -1.1991, -1.28854, 0.963941, 0.0),
    (Mode.CLOSED, 3, "exact"): (103.656, -1.26414, -1.25993, 0.9685, 0.0),
    (Mode.CLOSED, 4, "relaxed"): (257.974, 0.00358641, -2.11899, 1.43931, 0.0),
    (Mode.CLOSED, 4, "exact"): (258.291, -0.145096, -2.06478, 1.39069, 0.0),
    (Mode.OPEN, 3, "relaxed"): (110.972, 1.73082, -0.110691, 0.269736, 0.327084),
    (Mode.OPEN, 3, "exact"): (111.509, 1.84651, -0.0920031, 0.224984, 0.322738),
    (Mode.OPEN, 4, "relaxed"): (261.669, -0.717129, -1.25958, 1.03262, 0.599128),
    (Mode.OPEN, 4, "exact"): (262.422, -0.627315, -1.30057, 1.00505, 0.636277),
}


def scene(program: Program, device: torch.device | str = "cpu") -> EngineScene:
    """Overlapping faint curves, some of them partly outside the canvas."""
    count = points_from_segments(program.mode, SEGMENTS)
    along = torch.arange(count) / count
    shapes = []
    for i in range(CURVES):
        if program.mode is Mode.CLOSED:
            turn = 2.0 * math.pi * along + 0.7 * i
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
    return EngineScene(
        program.mode, WIDTH, HEIGHT, points, colours, opacities, half_widths, background, gradients=fills
    )  # fmt: skip


def gradients(device: torch.device | str) -> Gradients:
    """Flat fills, linear and radial gradients in turn, of one to three stops."""
    curves = torch.arange(CURVES)
    turn = 0.9 * curves[:, None, None] + torch.tensor([[0.0, 1.6], [1.6, 3.1]])
    plane = 0.06 * (turn.cos() + torch.eye(2))
    shift = 0.4 - plane @ torch.stack(((5.3 + 6.1 * curves) % WIDTH, (4.2 + 4.7 * curves) % HEIGHT), -1)[..., None]
    offsets = torch.stack((0.1 + 0.0 * curves, 0.4 + 0.1 * curves.sin(), 0.9 + 0.1 * curves.cos()), 1)
    stops = 0.5 + 0.45 * (curves[:, None, None] + 1.7 * torch.arange(12).view(3, 4)).sin()
    kinds, counts = curves % 3, 1 + curves // 3 % 3
    floats = (t.float().contiguous().to(device) for t in (torch.cat((plane, shift), 2), offsets, stops))
    frames, offsets, stops = floats
    return Gradients(kinds.int().to(device), frames, counts.int().to(device), offsets, stops)


def target(program: Program, device: torch.device | str = "cpu") -> Tensor:
    """A smooth picture (H, W, C)."""
    y, x = torch.meshgrid(torch.arange(HEIGHT) / HEIGHT, torch.arange(WIDTH) / WIDTH, indexing="ij")
    planes = [0.5 + 0.4 * (3.0 * x + 2.0 * y + c).sin() for c in range(program.channels)]
    return torch.stack(planes, -1).float().contiguous().to(device)


def untrained(program: Program, device: torch.device | str = "cpu") -> EngineScene:
    """The scene as a fit has it, with logits."""
    start = scene(program, device)
    start.logits = True
    return start


def settings(coverage: str) -> RasterSettings:
    return RasterSettings(coverage, 1.3, 5)


def digest(loss: float, values: list[Tensor]) -> tuple[float, ...]:
    """A few numbers that any mistake changes: sums with weights that differ from value to value."""
    weighted = []
    for value in values:
        flat = value.detach().double().cpu().reshape(-1)
        weighted.append(float(flat @ torch.arange(1, flat.numel() + 1).double().mul(0.7).cos()))
    return loss, *weighted


def gradient_names(program: Program) -> list[str]:
    """The values of `gradients()` that are compared."""
    strokes, fills = ["half_widths"] * (program.mode is Mode.OPEN), ["frames", "stops"] * program.painted
    return ["points", "colours", "opacities", *strokes, *fills, "importance"]


def _drawn(engine: Engine, program: Program, coverage: str) -> tuple[float, ...]:
    small, wanted = scene(program, engine.device), target(program, engine.device)
    image = engine.render(small, settings(coverage))
    loss, gradients = engine.gradients(small, settings(coverage), target=wanted, importance="loo")
    return digest(loss, [image, *(gradients[name] for name in gradient_names(program))])


def _trained(engine: Engine, program: Program, coverage: str) -> tuple[float, ...]:
    start, small = untrained(program, engine.device), untrained(program, engine.device)
    wanted = target(program, engine.device)
    state = OptimiserState.zeros_for(small.points)
    losses = [engine.step(small, settings(coverage), Training(wanted, state, RATES)) for _ in range(STEPS)]
    return digest(float(losses[-1]), [getattr(small, name) - getattr(start, name) for name in TRAINED])


def self_test(engine: Engine, program: Program) -> None:
    """Raises EngineError where the engine's numbers are not the expected ones: pictures, gradients, training steps."""
    for coverage in COVERAGES:
        key = (program.mode, program.channels, coverage)
        cases = [
            ("gradients", _drawn(engine, program, coverage), (EXPECTED_PAINTED if program.painted else EXPECTED)[key])
        ]
        if not program.painted:  # a step does nothing else with gradients
            cases.append(("training", _trained(engine, program, coverage), EXPECTED_STEPS[key]))
        for doing, got, expected in cases:
            for value, right in zip(got, expected, strict=True):
                if not abs(value - right) <= TOLERANCE * (1.0 + abs(right)):
                    raise EngineError(
                        f"the CUDA engine's self-test ({program.name}, {coverage} {doing}) gives {value:.6g} in place "
                        f"of {right:.6g}: the GPU, its driver or its compiler is broken; use --device cpu"
                    )
