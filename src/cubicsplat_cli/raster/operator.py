"""The engines as one differentiable torch operator, `cubicsplat::render`, for any loss.

The backward operator runs the same tile code with the incoming image gradient in place of the squared error's. It goes
forward again: the shapes over each pixel are kept for one tile at a time, in the nearest cache. Keeping them for the
whole picture between the two operators would cost more than it saves.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cubicsplat_cli.raster.engine import EngineScene
from cubicsplat_cli.raster.engines import shared_engine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.scene.arrays import Array
from cubicsplat_cli.scene.gradients import Gradients
from cubicsplat_cli.settings import Mode

# The tensors that the operators take, by their names among the scene's arrays. The first six are differentiable; all
# but the first four may be missing. Plain numbers follow: canvas: closed (0 or 1), width, height. background: empty, or
# RGB. counts: exact (0 or 1), samples, subdivide (0 or 1). lengths: edge width and tolerance, px.
_TENSORS = (
    "points", "colours", "opacities", "half_widths", "gradients.frames", "gradients.stops", "gradients.offsets",
    "gradients.kinds", "gradients.counts", "ring_ends",
)  # fmt: skip
_DIFFERENTIABLE, _FLOATS = 6, 7
_SCHEMA = (
    "Tensor points, Tensor colours, Tensor opacities, Tensor half_widths, Tensor? frames, Tensor? stops, "
    "Tensor? offsets, Tensor? kinds, Tensor? stop_counts, Tensor? ring_ends, "
    "int[] canvas, float[] background, int[] counts, float[] lengths"
)


def _inputs(scene: Scene, settings: RasterSettings) -> list[Any]:
    arrays = scene.arrays_by_name()
    tensors = [arrays.get(name) for name in _TENSORS]
    floats = [None if t is None else t.float() for t in tensors[:_FLOATS]]
    return [
        *floats[:_DIFFERENTIABLE], *map(_plain, [*floats[_DIFFERENTIABLE:], *tensors[_FLOATS:]]),
        [int(scene.mode is Mode.CLOSED), scene.width, scene.height], list(scene.background or ()),
        [int(settings.coverage == "exact"), settings.samples, int(settings.subdivide)],
        [settings.edge_width, settings.tolerance],
    ]  # fmt: skip


def _given(*inputs: Any) -> tuple[EngineScene, RasterSettings]:
    """Return the operators' inputs as the engines take them."""
    tensors = dict(zip(_TENSORS, map(_plain, inputs), strict=False))
    (closed, width, height), background, (exact, samples, subdivide), (edge_width, tolerance) = inputs[len(_TENSORS) :]
    fills = {name.partition(".")[2]: t for name, t in tensors.items() if "." in name}
    scene = EngineScene(
        Mode.CLOSED if closed else Mode.OPEN, width, height, **{name: tensors[name] for name in _TENSORS[:4]},
        background=tuple(background) or None, ring_ends=tensors["ring_ends"],
        gradients=None if fills["frames"] is None else Gradients(**fills),
    )  # fmt: skip
    return scene, RasterSettings("exact" if exact else "relaxed", edge_width, samples, tolerance, bool(subdivide))


def _plain(tensor: Array) -> Array:
    return None if tensor is None else tensor.detach().contiguous()


_operator = partial(torch.library.custom_op, mutates_args=(), device_types=("cpu", "cuda"))


@_operator("cubicsplat::render", schema=f"({_SCHEMA}) -> Tensor")
def render_op(*inputs: Any) -> Tensor:
    return shared_engine(inputs[0].device).render(*_given(*inputs))


@_operator(
    "cubicsplat::render_backward", schema=f"(Tensor gradient, {_SCHEMA}) -> ({', '.join(['Tensor'] * _DIFFERENTIABLE)})"
)
def render_backward_op(gradient: Tensor, *inputs: Any) -> tuple[Tensor, ...]:
    points = inputs[0]
    _, out = shared_engine(points.device).gradients(*_given(*inputs), gradient=_plain(gradient))
    names = [name.rpartition(".")[2] for name in _TENSORS[:_DIFFERENTIABLE]]
    return tuple(out[name] if name in out else points.new_empty(0) for name in names)


@render_op.register_fake
def _draw_fake(*inputs: Any) -> Tensor:
    (_, width, height), background = inputs[len(_TENSORS) :][:2]
    return inputs[0].new_empty((height, width, 3 if background else 4))


@render_backward_op.register_fake
def _differentiate_fake(gradient: Tensor, *inputs: Any) -> tuple[Tensor, ...]:
    return tuple(inputs[0].new_empty(0) if t is None else torch.empty_like(t) for t in inputs[:_DIFFERENTIABLE])


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    ctx.save_for_backward(*inputs[: len(_TENSORS)])
    ctx.numbers = inputs[len(_TENSORS) :]


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    found = render_backward_op(gradient, *ctx.saved_tensors, *ctx.numbers)
    given = ctx.saved_tensors[:_DIFFERENTIABLE]
    of_inputs = [None if t is None else of_t for t, of_t in zip(given, found, strict=True)]
    return *of_inputs, *([None] * (len(_TENSORS) + len(ctx.numbers) - _DIFFERENTIABLE))


render_op.register_autograd(_backward, setup_context=_remember)


def render(scene: Scene, settings: RasterSettings | None = None) -> Tensor:
    """Draw a scene, differentiably: (H, W, 3) over its background, or (H, W, 4) premultiplied RGBA without one.

    Gradients of any loss reach the scene's points, colours, opacities and half_widths, and its gradients' frames and
    stops, if these require them. The CPU engine or CUDA's makes the picture, on the tensors' device, in float32.
    settings: relaxed edges of 1 px by default; with exact coverage the gradient is that of the relaxed edge. A scene of
    numpy arrays is drawn on the CPU. Raises EngineError, and InputError for shapes and, on the CPU, for ranges and
    non-finite values: on a GPU nothing here waits for values.
    """
    if isinstance(scene.points, np.ndarray):
        scene = scene.as_torch()
    if isinstance(scene.points, Tensor) and scene.points.is_cuda:
        scene.validate_form()
    else:
        scene.validate()
    return render_op(*_inputs(scene, settings or RasterSettings()))
