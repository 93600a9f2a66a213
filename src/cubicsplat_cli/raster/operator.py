"""The engines as one differentiable torch operator, `cubicsplat::render`, for any loss.

The backward operator runs the same tile code with the incoming image gradient in place of the squared error's. It goes
forward again: what each pixel met on its way is kept for one tile at a time, in the nearest cache, and keeping it for
the whole picture between the two operators would cost more than it saves.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from torch import Tensor

from cubicsplat_cli.raster.engine import SceneArrays
from cubicsplat_cli.raster.engines import shared_engine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.gradients import Gradients
from cubicsplat_cli.settings import Mode

# An operator takes plain tensors and numbers: canvas = [closed, width, height], background = [] or RGB, counts =
# [exact, samples, subdivide], lengths = [edge_width, tolerance] in px.
# frames .. tallies are the gradients' (see `Gradients`).


def _scene(
    points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, frames: Tensor | None,
    stops: Tensor | None, offsets: Tensor | None, kinds: Tensor | None, tallies: Tensor | None,
    ring_ends: Tensor | None, canvas: list[int], background: list[float],
) -> SceneArrays:  # fmt: skip
    closed, width, height = canvas
    gradients = None
    if frames is not None:
        assert stops is not None and offsets is not None and kinds is not None and tallies is not None
        gradients = Gradients(kinds, frames.detach().contiguous(), tallies, offsets, stops.detach().contiguous())
    points, colours, opacities, half_widths = (
        t.detach().contiguous() for t in (points, colours, opacities, half_widths)
    )
    behind = (background[0], background[1], background[2]) if background else None
    mode = Mode.CLOSED if closed else Mode.OPEN
    return SceneArrays(
        mode, width, height, points, colours, opacities, half_widths, behind, ring_ends=ring_ends, gradients=gradients
    )  # fmt: skip


def _settings(counts: list[int], lengths: list[float]) -> RasterSettings:
    exact, samples, subdivide = counts
    edge_width, tolerance = lengths
    return RasterSettings("exact" if exact else "relaxed", edge_width, samples, tolerance, bool(subdivide))


@torch.library.custom_op("cubicsplat::render", mutates_args=(), device_types=("cpu", "cuda"))
def render_op(
    points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, frames: Tensor | None,
    stops: Tensor | None, offsets: Tensor | None, kinds: Tensor | None, tallies: Tensor | None,
    ring_ends: Tensor | None, canvas: list[int], background: list[float], counts: list[int], lengths: list[float],
) -> Tensor:  # fmt: skip
    scene = _scene(
        points, colours, opacities, half_widths, frames, stops, offsets, kinds, tallies, ring_ends, canvas, background
    )  # fmt: skip
    return shared_engine(points.device).render(scene, _settings(counts, lengths))


@render_op.register_fake
def _render_fake(
    points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, frames: Tensor | None,
    stops: Tensor | None, offsets: Tensor | None, kinds: Tensor | None, tallies: Tensor | None,
    ring_ends: Tensor | None, canvas: list[int], background: list[float], counts: list[int], lengths: list[float],
) -> Tensor:  # fmt: skip
    return points.new_empty((canvas[2], canvas[1], 3 if background else 4))


@torch.library.custom_op("cubicsplat::render_backward", mutates_args=(), device_types=("cpu", "cuda"))
def render_backward_op(
    gradient: Tensor, points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, frames: Tensor | None,
    stops: Tensor | None, offsets: Tensor | None, kinds: Tensor | None, tallies: Tensor | None,
    ring_ends: Tensor | None, canvas: list[int], background: list[float], counts: list[int], lengths: list[float],
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    scene = _scene(
        points, colours, opacities, half_widths, frames, stops, offsets, kinds, tallies, ring_ends, canvas, background
    )  # fmt: skip
    engine, settings = shared_engine(points.device), _settings(counts, lengths)
    _, out = engine.gradients(scene, settings, gradient=gradient.detach().contiguous())
    frames, stops = (out.get(name, points.new_empty(0)) for name in ("frames", "stops"))
    return out["points"], out["colours"], out["opacities"], out["half_widths"], frames, stops


@render_backward_op.register_fake
def _render_backward_fake(
    gradient: Tensor, points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, frames: Tensor | None,
    stops: Tensor | None, offsets: Tensor | None, kinds: Tensor | None, tallies: Tensor | None,
    ring_ends: Tensor | None, canvas: list[int], background: list[float], counts: list[int], lengths: list[float],
) -> tuple[Tensor, Tensor, Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    return (
        torch.empty_like(points),
        torch.empty_like(colours),
        torch.empty_like(opacities),
        torch.empty_like(half_widths),
        points.new_empty(0) if frames is None else torch.empty_like(frames),
        points.new_empty(0) if stops is None else torch.empty_like(stops),
    )


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    ctx.save_for_backward(*inputs[:10])
    ctx.settings = inputs[10:]


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    *found, frames, stops = render_backward_op(gradient, *ctx.saved_tensors, *ctx.settings)
    of_gradients = (frames, stops) if ctx.saved_tensors[4] is not None else (None, None)
    return *found, *of_gradients, *([None] * 8)


render_op.register_autograd(_backward, setup_context=_remember)


def render(scene: Scene, settings: RasterSettings | None = None) -> Tensor:
    """Draws a scene, differentiably: (H, W, 3) over its background, or (H, W, 4) premultiplied RGBA without one.

    Gradients of any loss reach the scene's points, colours, opacities and half_widths, and its gradients' frames and
    stops, wherever those require them. The picture is made by the CPU engine or CUDA's, on the device where the tensors
    live; float32. settings: relaxed edges of 1 px by default; with exact coverage the gradient is that of the relaxed
    edge. The same picture and gradients, up to rounding, as `reference.render`. A scene of numpy arrays is drawn on the
    CPU. Raises EngineError, and InputError for shapes and, on the CPU, for ranges and non-finite values: on a GPU
    nothing here waits for values.
    """
    if isinstance(scene.points, np.ndarray):
        scene = scene.as_torch()
    if isinstance(scene.points, Tensor) and scene.points.is_cuda:
        scene.validate_form()
    else:
        scene.validate()
    settings = settings or RasterSettings()
    tensors = (t.float() for t in (scene.points, scene.colours, scene.opacities, scene.half_widths))
    return render_op(
        *tensors,
        *_fills(scene.gradients),
        None if scene.ring_ends is None else scene.ring_ends.contiguous(),
        [int(scene.mode is Mode.CLOSED), scene.width, scene.height],
        list(scene.background or ()),
        [int(settings.coverage == "exact"), settings.samples, int(settings.subdivide)],
        [settings.edge_width, settings.tolerance],
    )


def _fills(gradients: Gradients | None) -> tuple[Tensor | None, ...]:
    """The five tensors in the operators' order."""
    if gradients is None:
        return None, None, None, None, None
    floats = (gradients.frames.float(), gradients.stops.float(), gradients.offsets.detach().float().contiguous())
    return *floats, gradients.kinds.contiguous(), gradients.counts.contiguous()
