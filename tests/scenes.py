"""Scenes shared by the tests: random ones from a seed, and degenerate ones no engine may stumble over."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import reference
import reference_coverage
import torch
from torch import Tensor

from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene, pack_rings, points_from_segments
from cubicsplat_cli.scene.gradients import RADIAL, Gradients
from cubicsplat_cli.settings import Mode

RGB = tuple[float, float, float]
PAPER: RGB = (0.9, 0.85, 0.7)
TENSORS = ("points", "colours", "opacities", "half_widths")
MODES = list(Mode)
BACKGROUNDS = [pytest.param(PAPER, id="rgb"), pytest.param(None, id="rgba")]
COVERAGES = ["relaxed", "exact"]
# The half-widths of fills.
ZERO = torch.zeros((), dtype=torch.float64)


def random_scene(
    mode: Mode,
    curves: int = 6,
    segments: int = 3,
    width: int = 24,
    height: int = 20,
    seed: int = 0,
    *,
    background: RGB | None = None,
    opacity: tuple[float, float] = (0.2, 0.9),
    scale: float = 0.25,
    half_width: tuple[float, float] = (0.3, 2.5),
) -> Scene:
    """Curves at random places, a few of which reach over the canvas edge; the same for the same arguments.

    opacity, half_width: ranges (low, high); half-widths in px, for open curves only. scale: a closed curve's
    radius, and half an open one's length, as a fraction of the longer side.
    """
    generator = torch.Generator().manual_seed(seed)

    def uniform(*shape: int, low: float = 0.0, high: float = 1.0) -> Tensor:
        return low + (high - low) * torch.rand(shape, generator=generator)

    count = points_from_segments(mode, segments)
    size = scale * max(width, height)
    centres = uniform(curves, 1, 2) * torch.tensor([width, height])
    if mode is Mode.CLOSED:
        turn = 2.0 * math.pi * (torch.arange(count) / count + uniform(curves, 1))
        base = size * torch.stack((turn.cos(), turn.sin()), dim=-1)
    else:
        turn = 2.0 * math.pi * uniform(curves, 1)
        along = size * torch.linspace(-1.0, 1.0, count)
        base = torch.stack((along * turn.cos(), along * turn.sin()), dim=-1)
    points = centres + base + uniform(curves, count, 2, low=-0.4 * size, high=0.4 * size)
    is_open = mode is Mode.OPEN
    half_widths = uniform(curves, low=half_width[0], high=half_width[1]) if is_open else torch.zeros(curves)
    return Scene(
        mode=mode,
        width=width,
        height=height,
        points=points,
        colours=uniform(curves, 3),
        opacities=uniform(curves, low=opacity[0], high=opacity[1]),
        half_widths=half_widths,
        background=background,
    )


def ragged_scene(
    mode: Mode, curves: int = 6, width: int = 24, height: int = 20, seed: int = 0, *, background: RGB | None = None
) -> Scene:
    """Like `random_scene`, but with 1 to 5 segments a curve; every other fill has a hole, or a hole and an island."""
    shapes = []
    for index in range(curves):
        segments = (index + seed) % 5 + 1
        ring = random_scene(mode, 1, segments, width, height, 31 * seed + index).points[0]
        rings = [ring]
        if mode is Mode.CLOSED and index % 2:
            centre = ring.mean(dim=0)
            rings.append(reverse_ring(centre + 0.5 * (ring - centre)))
            rings += [centre + 0.25 * (ring - centre)] * (index % 4 == 3)
        shapes.append(rings)
    points, ring_ends = pack_rings(mode, shapes)
    painted = random_scene(mode, curves, 1, width, height, seed, background=background)
    return replace(painted, points=points, ring_ends=ring_ends)


def random_gradients(scene: Scene, seed: int = 0, most: int = 4) -> Gradients:
    """Flat, linear and radial ones with a focus in turn, with one to `most` stops, some of them hard."""
    generator = torch.Generator().manual_seed(seed)
    n = scene.curves
    kinds = torch.arange(n, dtype=torch.int32) % 3
    counts = torch.tensor([1 + (i * 5 + 2) % most if i % 7 else most for i in range(n)], dtype=torch.int32)
    offsets = torch.rand(n, most, generator=generator).sort(dim=1).values
    offsets[::4, -1] = offsets[::4, -2]
    middle = torch.tensor([scene.width, scene.height]) * torch.rand(n, 2, generator=generator)
    size = 0.5 * max(scene.width, scene.height)
    plane = torch.randn(n, 2, 2, generator=generator) / size
    frames = torch.cat((plane, 0.3 - plane @ middle[:, :, None]), dim=2)
    stops = 0.1 + 0.8 * torch.rand(n, most, 4, generator=generator)
    leans = 0.6 * (torch.rand(n, 2, generator=generator) - 0.5) * (kinds == RADIAL)[:, None]
    return Gradients(kinds, torch.cat((frames, leans[..., None]), dim=2), counts, offsets, stops)


def painted_scene(
    mode: Mode, curves: int = 9, width: int = 33, height: int = 27, seed: int = 1, **options: Any
) -> Scene:
    """Like `random_scene`, with those gradients."""
    scene = random_scene(mode, curves, 3, width, height, seed, scale=0.45, **options)
    return replace(scene, gradients=random_gradients(scene, seed))


def random_target(scene: Scene, seed: int = 0) -> Tensor:
    """A float32 picture (H, W, C) to compare with: smooth noise, premultiplied when it has four channels."""
    generator = torch.Generator().manual_seed(seed)
    noise = torch.rand(1, scene.channels, 4, 4, generator=generator)
    size = (scene.height, scene.width)
    picture = torch.nn.functional.interpolate(noise, size, mode="bilinear", align_corners=True)
    picture = picture[0].permute(1, 2, 0).contiguous()
    if scene.channels == 4:
        picture[..., :3] *= picture[..., 3:]
    return picture


def in_double(scene: Scene, requires_grad: bool = False) -> Scene:
    """The scene with float64 leaves."""
    return replace(scene, **{n: getattr(scene, n).detach().double().requires_grad_(requires_grad) for n in TENSORS})


def only(scene: Scene, curves: list[int]) -> Scene:
    """The scene with the curves of the given indices alone, in their order."""
    ring_ends = None if scene.ring_ends is None else scene.ring_ends[curves]
    return replace(scene, ring_ends=ring_ends, **{name: getattr(scene, name)[curves] for name in TENSORS})


def reference_render(scene: Scene, coverage: str = "relaxed", edge_width: float = 1.0, samples: int = 6) -> Tensor:
    """The reference renderer's picture (H, W, C), float64, differentiable in the scene's tensors."""
    return reference.render(scene, RasterSettings(coverage, edge_width, samples))


def assert_close(found: Tensor, wanted: Tensor, rtol: float = 1e-7, atol: float = 1e-7) -> None:
    """As torch.testing.assert_close for float64, which imports torch.distributed: half a second in each process."""
    np.testing.assert_allclose(found.detach().numpy(), wanted.detach().numpy(), rtol=rtol, atol=atol, strict=True)


def slopes(function: Callable[[Tensor], Any], values: Tensor, step: float, every: int = 1) -> dict[int, float]:
    """Central differences of a function in every so many of its values, by their indices."""

    def moved(index: int, by: float) -> float:
        changed = values.detach().clone()
        changed.view(-1)[index] += by
        with torch.no_grad():
            return float(function(changed))

    return {i: (moved(i, step) - moved(i, -step)) / (2.0 * step) for i in range(0, values.numel(), every)}


def polyline(points: Tensor, mode: Mode = Mode.CLOSED, samples: int = 3) -> Tensor:
    """(V, 2) float64 vertices of one curve (K, 2)."""
    return reference_coverage.flatten(points.unsqueeze(0), mode, samples)[0]


def point(x: float, y: float) -> Tensor:
    """One place (1, 2) in px, float64."""
    return torch.tensor([[x, y]], dtype=torch.float64)


def straight(anchors: Sequence[tuple[float, float]], closed: bool) -> Tensor:
    """Control points (K, 2) of a curve whose cubics are the straight lines between anchors (px)."""
    corners = torch.tensor(anchors, dtype=torch.float32)
    ends = corners.roll(-1, dims=0) if closed else corners[1:]
    starts = corners if closed else corners[:-1]
    thirds = torch.stack([starts + (ends - starts) * (k / 3.0) for k in range(3)], dim=1).flatten(0, 1)
    return thirds if closed else torch.cat((thirds, corners[-1:]))


def rectangle(left: float, top: float, right: float, bottom: float) -> Tensor:
    """Control points (12, 2) of an axis-aligned rectangle, clockwise on the screen (positive area)."""
    return straight([(left, top), (right, top), (right, bottom), (left, bottom)], closed=True)


def reverse_ring(points: Tensor) -> Tensor:
    """A closed curve (K, 2) run through the other way, from the same anchor."""
    return points.flip(0).roll(1, dims=0)


def circle(x: float, y: float, radius: float, segments: int = 4) -> Tensor:
    """Control points (3M, 2) of a circle, clockwise on the screen; radial error about 2.7e-4 r for M = 4."""
    handle = 4.0 / 3.0 * math.tan(math.pi / (2.0 * segments))
    rows = []
    for m in range(segments):
        a, b = 2.0 * math.pi * m / segments, 2.0 * math.pi * (m + 1) / segments
        rows.append((math.cos(a), math.sin(a)))
        rows.append((math.cos(a) - handle * math.sin(a), math.sin(a) + handle * math.cos(a)))
        rows.append((math.cos(b) + handle * math.sin(b), math.sin(b) - handle * math.cos(b)))
    return torch.tensor([x, y]) + radius * torch.tensor(rows)


def scene_of(
    mode: Mode,
    curves: list[Tensor],
    width: int,
    height: int,
    *,
    background: RGB | None = None,
    opacity: float = 0.7,
    half_width: float = 1.5,
) -> Scene:
    """A scene of the given control points (K, 2), all with one opacity and (open) one half-width, in px.

    Colours differ from curve to curve, so that a wrong order shows.
    """
    count = len(curves)
    steps = torch.arange(count, dtype=torch.float32)
    colours = torch.stack([((0.31 * steps + 0.1 + 0.27 * c) % 1.0) for c in range(3)], dim=1)
    width_of_strokes = half_width if mode is Mode.OPEN else 0.0
    return Scene(
        mode=mode,
        width=width,
        height=height,
        points=torch.stack(curves),
        colours=colours,
        opacities=torch.full((count,), opacity),
        half_widths=torch.full((count,), width_of_strokes),
        background=background,
    )


def figure_eight(mode: Mode, width: float, height: float) -> Tensor:
    """Control points of a curve that crosses itself: two lobes of opposite turn, or a stroke with a loop."""
    if mode is Mode.CLOSED:
        corners = [(0.1, 0.2), (0.9, 0.8), (0.9, 0.2), (0.1, 0.8)]
        return straight([(x * width, y * height) for x, y in corners], closed=True)
    shape = [(0.1, 0.2), (1.1, 0.9), (-0.1, 0.9), (0.9, 0.2)]
    return torch.tensor([(x * width, y * height) for x, y in shape])


def _curves(mode: Mode, width: int, height: int, seed: int, count: int = 3) -> list[Tensor]:
    return list(random_scene(mode, count, 3, width, height, seed).points)


def _degenerate_shapes(mode: Mode, background: RGB | None) -> dict[str, Scene]:
    """Scenes whose curves are degenerate, on an ordinary canvas."""
    points = points_from_segments(mode, 3)
    others = _curves(mode, 21, 19, seed=1, count=2)
    line = torch.stack((torch.linspace(3.25, 17.5, points), torch.linspace(4.0, 12.5, points)), dim=1)
    fold = torch.cat((line[: points // 2 + 1], line[: points - points // 2 - 1].flip(0)))

    def scene(*curves: Tensor, **options: float) -> Scene:
        return scene_of(mode, list(curves), 21, 19, background=background, **options)

    whole = torch.tensor([[8.5, 9.5]]).expand(points, 2).clone()
    huge = (others[1] - 10.0) * 40.0 + 10.0
    return {
        "coincident-points": scene(whole, *others),
        "coincident-points-off-centre": scene(whole + 0.3, *others),
        "repeated-anchors": scene(others[0].repeat_interleave(3, dim=0)[:points], others[1]),
        "zero-area": scene(line, *others),
        "folded-back": scene(fold, *others),
        "same-curve-twice": scene(others[0], others[0].clone(), others[1]),
        "off-canvas-left": scene(others[0] - torch.tensor([100.0, 0.0]), others[1]),
        "off-canvas-below": scene(others[0] + torch.tensor([0.0, 500.0]), others[1]),
        "far-away": scene(others[0] + 1e5, others[1]),
        "all-off-canvas": scene(others[0] - 300.0, others[1] + 300.0),
        "figure-eight": scene(figure_eight(mode, 21, 19)),
        "opacity-0": scene(*others, opacity=0.0),
        "opacity-1": scene(*others, opacity=1.0),
        "covers-all": scene(others[0], huge, half_width=30.0, opacity=0.6),
        "hides-all": scene(huge, others[0], half_width=900.0, opacity=1.0),
    }


def _degenerate_canvases(mode: Mode, background: RGB | None) -> dict[str, Scene]:
    """Ordinary curves on canvases of awkward size: one pixel, one row or column, no multiple of 16 px."""
    sizes = [(1, 1), (1, 37), (37, 1), (16, 16), (17, 33), (31, 15)]
    return {
        f"canvas-{width}x{height}": scene_of(
            mode, _curves(mode, width, height, seed=width), width, height, background=background
        )
        for width, height in sizes
    }


def _thin_strokes(background: RGB | None) -> dict[str, Scene]:
    curves = _curves(Mode.OPEN, 20, 18, seed=4)
    return {
        f"stroke-{half_width}": scene_of(Mode.OPEN, curves, 20, 18, background=background, half_width=half_width)
        for half_width in (0.0, 0.2)
    }


def _degenerate() -> list[tuple[str, Scene]]:
    scenes = []
    for mode in Mode:
        for label, background in (("rgb", PAPER), ("rgba", None)):
            named = _degenerate_shapes(mode, background) | _degenerate_canvases(mode, background)
            if mode is Mode.OPEN:
                named |= _thin_strokes(background)
            scenes += [(f"{mode.value}-{label}-{name}", scene) for name, scene in named.items()]
    return scenes


DEGENERATE: list[tuple[str, Scene]] = _degenerate()
"""(name, scene) pairs of both modes, over a background and without one; every scene passes `validate`."""
