"""The engines as one differentiable torch operator, `cubicsplat::render`, for any loss.

The backward operator runs the same tile code with the incoming image gradient in place of the squared error's. It goes
forward again: what each pixel met on its way is kept for one tile at a time, in the nearest cache, and keeping it for
the whole picture between the two operators would cost more than it saves.
"""

from __future__ import annotations

from typing import Any, NamedTuple

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


class _Inputs(NamedTuple):
    """What the operators take: plain tensors and numbers only. The names are those of `Scene` and `Gradients`.

    canvas: closed (0 or 1), width, height. background: empty, or RGB. counts: exact (0 or 1), samples, subdivide (0 or
    1). lengths: edge width and tolerance, px.
    """

    points: Tensor
    colours: Tensor
    opacities: Tensor
    half_widths: Tensor
    frames: Tensor | None
    stops: Tensor | None
    offsets: Tensor | None
    kinds: Tensor | None
    stop_counts: Tensor | None
    ring_ends: Tensor | None
    canvas: list[int]
    background: list[float]
    counts: list[int]
    lengths: list[float]

    @classmethod
    def of(cls, scene: Scene, settings: RasterSettings) -> _Inputs:
        fills = scene.gradients
        return cls(
            scene.points.float(), scene.colours.float(), scene.opacities.float(), scene.half_widths.float(),
            None if fills is None else fills.frames.float(),
            None if fills is None else fills.stops.float(),
            None if fills is None else _plain(fills.offsets.float()),
            None if fills is None else _plain(fills.kinds),
            None if fills is None else _plain(fills.counts),
            _plain(scene.ring_ends),
            [int(scene.mode is Mode.CLOSED), scene.width, scene.height],
            list(scene.background or ()),
            [int(settings.coverage == "exact"), settings.samples, int(settings.subdivide)],
            [settings.edge_width, settings.tolerance],
        )  # fmt: skip

    def scene(self) -> EngineScene:
        closed, width, height = self.canvas
        gradients = None
        if self.frames is not None:
            gradients = Gradients(self.kinds, _plain(self.frames), self.stop_counts, self.offsets, _plain(self.stops))
        r, g, b = self.background or (0.0, 0.0, 0.0)
        return EngineScene(
            Mode.CLOSED if closed else Mode.OPEN, width, height, _plain(self.points), _plain(self.colours),
            _plain(self.opacities), _plain(self.half_widths), (r, g, b) if self.background else None, self.ring_ends,
            gradients,
        )  # fmt: skip

    def settings(self) -> RasterSettings:
        exact, samples, subdivide = self.counts
        return RasterSettings(
            "exact" if exact else "relaxed", self.lengths[0], samples, self.lengths[1], bool(subdivide)
        )


_TENSORS = _Inputs._fields.index("canvas")  # how many of the inputs are tensors
_DIFFERENTIABLE = 6  # of them the first ones, of which frames and stops may be missing
_SCHEMA = ", ".join(
    [f"Tensor {name}" for name in _Inputs._fields[:4]]
    + [f"Tensor? {name}" for name in _Inputs._fields[4:_TENSORS]]
    + ["int[] canvas, float[] background, int[] counts, float[] lengths"]
)
_DEVICES = ("cpu", "cuda")


def _plain(tensor: Array) -> Array:
    return None if tensor is None else tensor.detach().contiguous()


def _draw(*inputs: Any) -> Tensor:
    given = _Inputs(*inputs)
    return shared_engine(given.points.device).render(given.scene(), given.settings())


def _differentiate(gradient: Tensor, *inputs: Any) -> tuple[Tensor, ...]:
    given = _Inputs(*inputs)
    engine = shared_engine(given.points.device)
    _, out = engine.gradients(given.scene(), given.settings(), gradient=gradient.detach().contiguous())
    names = _Inputs._fields[:_DIFFERENTIABLE]
    return tuple(out[name] if name in out else given.points.new_empty(0) for name in names)


render_op = torch.library.custom_op(
    "cubicsplat::render", _draw, mutates_args=(), device_types=_DEVICES, schema=f"({_SCHEMA}) -> Tensor"
)
render_backward_op = torch.library.custom_op(
    "cubicsplat::render_backward",
    _differentiate,
    mutates_args=(),
    device_types=_DEVICES,
    schema=f"(Tensor gradient, {_SCHEMA}) -> ({', '.join(['Tensor'] * _DIFFERENTIABLE)})",
)


@render_op.register_fake
def _draw_fake(*inputs: Any) -> Tensor:
    given = _Inputs(*inputs)
    return given.points.new_empty((given.canvas[2], given.canvas[1], 3 if given.background else 4))


@render_backward_op.register_fake
def _differentiate_fake(gradient: Tensor, *inputs: Any) -> tuple[Tensor, ...]:
    return tuple(inputs[0].new_empty(0) if t is None else torch.empty_like(t) for t in inputs[:_DIFFERENTIABLE])


def _remember(ctx: Any, inputs: tuple[Any, ...], output: Tensor) -> None:
    ctx.save_for_backward(*inputs[:_TENSORS])
    ctx.numbers = inputs[_TENSORS:]


def _backward(ctx: Any, gradient: Tensor) -> tuple[Tensor | None, ...]:
    found = render_backward_op(gradient, *ctx.saved_tensors, *ctx.numbers)
    given = ctx.saved_tensors[:_DIFFERENTIABLE]
    of_inputs = [None if t is None else of_t for t, of_t in zip(given, found, strict=True)]
    return *of_inputs, *([None] * (len(_Inputs._fields) - _DIFFERENTIABLE))


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
    return render_op(*_Inputs.of(scene, settings or RasterSettings()))
