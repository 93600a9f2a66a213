"""The engines as one differentiable torch operator, `cubicsplat::render`, for any loss.

The backward operator runs the same tile code with the incoming image gradient in place of the squared error's.
"""

from __future__ import annotations

import torch
from torch import Tensor

from cubicsplat_cli.raster.engine import SceneTensors
from cubicsplat_cli.raster.engines import shared_engine
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode


def _pack(
    points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, closed: bool, width: int, height: int,
    background: list[float],
) -> SceneTensors:  # fmt: skip
    tensors = (t.detach().contiguous() for t in (points, colours, opacities, half_widths))
    behind = (background[0], background[1], background[2]) if background else None
    return SceneTensors(Mode.CLOSED if closed else Mode.OPEN, width, height, *tensors, behind)


def _settings(exact: bool, edge_width: float, samples: int, tolerance: float) -> RasterSettings:
    return RasterSettings("exact" if exact else "relaxed", edge_width, samples, tolerance)


@torch.library.custom_op("cubicsplat::render", mutates_args=(), device_types=("cpu", "cuda"))
def render_op(
    points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, closed: bool, width: int, height: int,
    background: list[float], exact: bool, edge_width: float, samples: int, tolerance: float,
) -> Tensor:  # fmt: skip
    scene = _pack(points, colours, opacities, half_widths, closed, width, height, background)
    return shared_engine(points.device).render(scene, _settings(exact, edge_width, samples, tolerance))


@render_op.register_fake
def _render_fake(
    points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, closed: bool, width: int, height: int,
    background: list[float], exact: bool, edge_width: float, samples: int, tolerance: float,
) -> Tensor:  # fmt: skip
    return points.new_empty((height, width, 3 if background else 4))


@torch.library.custom_op("cubicsplat::render_backward", mutates_args=(), device_types=("cpu", "cuda"))
def render_backward_op(
    gradient: Tensor, points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, closed: bool,
    width: int, height: int, background: list[float], exact: bool, edge_width: float, samples: int, tolerance: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    scene = _pack(points, colours, opacities, half_widths, closed, width, height, background)
    settings = _settings(exact, edge_width, samples, tolerance)
    _, out = shared_engine(points.device).gradients(scene, settings, gradient=gradient.detach().contiguous())
    return out["points"], out["colours"], out["opacities"], out["half_widths"]


@render_backward_op.register_fake
def _render_backward_fake(
    gradient: Tensor, points: Tensor, colours: Tensor, opacities: Tensor, half_widths: Tensor, closed: bool,
    width: int, height: int, background: list[float], exact: bool, edge_width: float, samples: int, tolerance: float,
) -> tuple[Tensor, Tensor, Tensor, Tensor]:  # fmt: skip
    return tuple(torch.empty_like(t) for t in (points, colours, opacities, half_widths))


def _remember(ctx, inputs, output) -> None:
    ctx.save_for_backward(*inputs[:4])
    ctx.settings = inputs[4:]


def _backward(ctx, gradient):
    return *render_backward_op(gradient, *ctx.saved_tensors, *ctx.settings), *([None] * len(ctx.settings))


render_op.register_autograd(_backward, setup_context=_remember)


def render(
    points: Tensor,
    colours: Tensor,
    opacities: Tensor,
    half_widths: Tensor,
    *,
    mode: Mode,
    width: int,
    height: int,
    background: tuple[float, float, float] | None,
    settings: RasterSettings,
) -> Tensor:
    """Draws N curves, differentiably: (H, W, 3) over `background`, or (H, W, 4) premultiplied RGBA without one.

    points (N, K, 2) px, colours (N, 3) and opacities (N,) in [0, 1], half_widths (N,) px; float32, front to back; all
    on the CPU or on one CUDA GPU, where the picture is made. The same arguments and, up to rounding, the same picture
    and gradients as `reference.render`. With exact coverage the gradient is that of the relaxed edge. Raises InputError
    (shapes, ranges, non-finite values) and EngineError.
    """
    Scene(mode, width, height, points, colours, opacities, half_widths, background).validate()
    return render_op(
        points.float(), colours.float(), opacities.float(), half_widths.float(), mode is Mode.CLOSED, width, height,
        list(background or ()), settings.coverage == "exact", settings.edge_width, settings.samples, settings.tolerance,
    )  # fmt: skip
