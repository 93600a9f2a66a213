"""Curves fitted by diffvg (Li et al. 2020) in its painterly way, where somebody has built its `pydiffvg`."""

from __future__ import annotations

import importlib
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

SEGMENTS = 4
ITERATIONS = 500
_SPREAD = 0.05  # of the picture's side: how far a new curve reaches
_RATES = {"points": 1.0, "colours": 0.01}
_GRID = 2  # samples a side of a pixel


def diffvg_svg(pixels: np.ndarray, curves: int, *, iterations: int = ITERATIONS, seed: int = 0) -> bytes:
    """An SVG of so many closed curves. pixels: (H, W, 4) uint8, laid over white. Raises ImportError without pydiffvg.

    As in the authors' example: random places, Adam on control points and RGBA, squared error.
    """
    diffvg = importlib.import_module("pydiffvg")
    import torch

    generator = torch.Generator().manual_seed(seed)
    height, width = pixels.shape[:2]
    values = torch.from_numpy(pixels.astype(np.float32) / 255.0)
    goal = values[..., :3] * values[..., 3:] + 1.0 - values[..., 3:]
    size = torch.tensor([width, height], dtype=torch.float32)
    paths, groups = [], []
    for index in range(curves):
        steps = _SPREAD * (torch.rand((3 * SEGMENTS, 2), generator=generator) - 0.5)
        points = ((torch.rand(2, generator=generator) + steps.cumsum(0)) * size).requires_grad_()
        counts = torch.full((SEGMENTS,), 2, dtype=torch.int32)
        paths.append(diffvg.Path(counts, points, torch.tensor(1.0), True))
        colour = torch.rand(4, generator=generator).requires_grad_()
        groups.append(diffvg.ShapeGroup(torch.tensor([index]), colour))
    points_of, colours = [path.points for path in paths], [group.fill_color for group in groups]
    optimisers = [
        torch.optim.Adam(points_of, lr=_RATES["points"]),
        torch.optim.Adam(colours, lr=_RATES["colours"]),
    ]
    for step in range(iterations):
        for optimiser in optimisers:
            optimiser.zero_grad()
        image = _drawn(diffvg, width, height, paths, groups, step)
        over_white = image[..., :3] * image[..., 3:] + 1.0 - image[..., 3:]
        (over_white - goal).pow(2).mean().backward()
        for optimiser in optimisers:
            optimiser.step()
        for colour in colours:
            colour.data.clamp_(0.0, 1.0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "drawing.svg"
        diffvg.save_svg(str(path), width, height, paths, groups)
        return path.read_bytes()


def _drawn(diffvg: Any, width: int, height: int, paths: list[Any], groups: list[Any], seed: int) -> Any:
    scene = diffvg.RenderFunction.serialize_scene(width, height, paths, groups)
    return diffvg.RenderFunction.apply(width, height, _GRID, _GRID, seed, None, *scene)
