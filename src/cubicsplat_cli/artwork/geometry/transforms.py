"""Ways by which an outline becomes another one: mirrored, turned and shifted."""

from __future__ import annotations

import math

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring, turn_matrix
from cubicsplat_cli.record import record


@record
class RigidTransform:
    """A rigid transform of an outline: x and y times `signs`, 1 or -1 each, turned about the origin by `angle`, and
    then shifted by px."""

    signs: tuple[float, float]
    shift: tuple[float, float]
    angle: float = 0.0

    @property
    def matrix(self) -> np.ndarray:
        """(2, 2) what rows of x and y are multiplied with before they are shifted; exact for quarter turns."""
        turn = turn_matrix(self.angle)
        return np.array(self.signs)[:, None] * (np.rint(turn) if is_quarter(self.angle) else turn)

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 2) where they come to lie."""
        return points @ self.matrix + np.array(self.shift)

    def after(self, first: RigidTransform) -> RigidTransform:
        """Another way and then this one, as one way."""
        mirrored = self.signs[0] != self.signs[1]
        signs = (first.signs[0] * self.signs[0], first.signs[1] * self.signs[1])
        x, y = self.points(np.array(first.shift)).tolist()
        return RigidTransform(signs, (x, y), (-first.angle if mirrored else first.angle) + self.angle)

    def outline(self, outline: Outline) -> Outline:
        """An outline where it comes to lie; a ring has the same pieces in the same order."""
        if isinstance(outline, Ring):
            return Ring(self.points(outline.anchors), self.points(outline.controls), outline.lines, outline.smooth)
        if isinstance(outline, Rectangle):
            half = np.array([0.5 * outline.width, 0.5 * outline.height])
            middle = self.points(np.array([outline.x, outline.y]) + half)
            half, angle = self._turned(half, outline.angle)
            x, y = (middle - half).tolist()
            return Rectangle(x, y, float(2.0 * half[0]), float(2.0 * half[1]), outline.radius, angle)
        x, y = self.points(np.array([outline.cx, outline.cy])).tolist()
        if isinstance(outline, Circle):
            return Circle(x, y, outline.r)
        (rx, ry), angle = self._turned(np.array([outline.rx, outline.ry]), outline.angle)
        return Ellipse(x, y, float(rx), float(ry), angle)

    def _turned(self, half: np.ndarray, angle: float) -> tuple[np.ndarray, float]:
        """The half sides (2,) of a box or an ellipse, and its angle within 90 degrees, 0 where it is level."""
        mirrored = self.signs[0] != self.signs[1]
        angle = math.remainder((-angle if mirrored else angle) + self.angle, math.pi)
        if not is_quarter(angle):
            return half, angle
        return (half[::-1], 0.0) if abs(angle) > 1.0 else (half, 0.0)


def is_quarter(angle: float) -> bool:
    """Return whether an angle is a whole multiple of 90 degrees but for the arithmetic."""
    return abs(math.remainder(angle, 0.5 * math.pi)) < 1e-12
