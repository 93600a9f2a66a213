"""Ways by which an outline becomes another one: mirrored and shifted."""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Outline, Rectangle, Ring
from cubicsplat_cli.record import record


@record
class RigidTransform:
    """A rigid transform of an outline: x and y times `signs`, 1 or -1 each, and then shifted by px."""

    signs: tuple[float, float]
    shift: tuple[float, float]

    def points(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 2) where they come to lie."""
        return points * np.array(self.signs) + np.array(self.shift)

    def outline(self, outline: Outline) -> Outline:
        """An outline where it comes to lie; a ring has the same pieces in the same order."""
        if isinstance(outline, Ring):
            return Ring(self.points(outline.anchors), self.points(outline.controls), outline.lines, outline.smooth)
        mirrored = self.signs[0] != self.signs[1]
        if isinstance(outline, Rectangle):
            half = np.array([0.5 * outline.width, 0.5 * outline.height])
            x, y = (self.points(np.array([outline.x, outline.y]) + half) - half).tolist()
            angle = -outline.angle if mirrored else outline.angle
            return Rectangle(x, y, outline.width, outline.height, outline.radius, angle)
        x, y = self.points(np.array([outline.cx, outline.cy])).tolist()
        if isinstance(outline, Circle):
            return Circle(x, y, outline.r)
        return Ellipse(x, y, outline.rx, outline.ry, -outline.angle if mirrored else outline.angle)
