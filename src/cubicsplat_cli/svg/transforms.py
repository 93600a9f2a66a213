"""Transform attributes as matrices (SVG 1.1, section 7.6)."""

from __future__ import annotations

import math
import re

import numpy as np

_TRANSFORM = re.compile(r"(matrix|translate|scale|rotate|skewX|skewY)\s*\(([^)]*)\)")


def transform_matrix(transform: str) -> np.ndarray:
    """(3, 3) of a transform attribute; ValueError where its numbers are none, or too few."""
    total = np.eye(3)
    for name, text in _TRANSFORM.findall(transform):
        numbers = [float(number) for number in text.replace(",", " ").split()]
        if len(numbers) < (6 if name == "matrix" else 1):
            raise ValueError(f"{name}({text}) lacks numbers")
        total = total @ one_transform(name, numbers)
    return total


def one_transform(name: str, n: list[float]) -> np.ndarray:
    """(3, 3) of a transform by its name and as many numbers as it may have."""
    if name == "matrix":
        return np.array([[n[0], n[2], n[4]], [n[1], n[3], n[5]], [0.0, 0.0, 1.0]])
    if name == "translate":
        return np.array([[1.0, 0.0, n[0]], [0.0, 1.0, n[1] if len(n) > 1 else 0.0], [0.0, 0.0, 1.0]])
    if name == "scale":
        return np.diag([n[0], n[-1], 1.0])
    angle = math.radians(n[0])
    if name.startswith("skew"):
        skewed = np.eye(3)
        skewed[(0, 1) if name == "skewX" else (1, 0)] = math.tan(angle)
        return skewed
    cos, sin = math.cos(angle), math.sin(angle)
    turn = np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])
    if len(n) < 3:
        return turn
    return one_transform("translate", n[1:3]) @ turn @ one_transform("translate", [-n[1], -n[2]])
