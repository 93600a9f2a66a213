"""Transform attributes as matrices."""

from __future__ import annotations

import math
import re

import numpy as np

_TRANSFORM = re.compile(r"(matrix|translate|scale|rotate)\s*\(([^)]*)\)")


def transform_matrix(transform: str) -> np.ndarray:
    """(3, 3) of a transform attribute; skews, which no tool here writes, are left out."""
    total = np.eye(3)
    for name, text in _TRANSFORM.findall(transform):
        total = total @ _step(name, [float(number) for number in text.replace(",", " ").split()])
    return total


def _step(name: str, n: list[float]) -> np.ndarray:
    if name == "matrix":
        return np.array([[n[0], n[2], n[4]], [n[1], n[3], n[5]], [0.0, 0.0, 1.0]])
    if name == "translate":
        return np.array([[1.0, 0.0, n[0]], [0.0, 1.0, n[1] if len(n) > 1 else 0.0], [0.0, 0.0, 1.0]])
    if name == "scale":
        return np.diag([n[0], n[-1], 1.0])
    cos, sin = math.cos(math.radians(n[0])), math.sin(math.radians(n[0]))
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    if len(n) < 3:
        return turn
    return _step("translate", n[1:3]) @ turn @ _step("translate", [-n[1], -n[2]])
