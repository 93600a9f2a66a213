"""An SVG document that can be drawn at any scale, in parts, and with or without smoothed edges."""

from __future__ import annotations

import math
from collections.abc import Sequence
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.evaluate.untrusted import check_untrusted

ElementTree.register_namespace("", "http://www.w3.org/2000/svg")
ElementTree.register_namespace("xlink", "http://www.w3.org/1999/xlink")


class Document:
    """An SVG on a canvas of width x height whole px; one px is `unit` of the document's own units.

    Raises InputError where the text is no SVG that may be drawn, or says no size.
    """

    def __init__(self, data: bytes, source: str, longest: int | None = None) -> None:
        """data: the file. source: its name in messages. longest: px of the longer side, by default as the file says.

        The canvas loses the fraction of a px that the shorter side may have: everything keeps its shape, and no edge of
        the canvas runs through the middle of a px.
        """
        size = check_untrusted(data, source)
        self.root = ElementTree.fromstring(data)
        left, top, across, down = self._view_box(size.width, size.height)
        self.origin = (left, top)
        self.unit = across / size.width if longest is None else max(across, down) / longest
        self.width = max(1, math.floor(across / self.unit + 1e-6))
        self.height = max(1, math.floor(down / self.unit + 1e-6))

    def _view_box(self, width: float, height: float) -> tuple[float, float, float, float]:
        numbers = self.root.get("viewBox", "").replace(",", " ").split()
        if len(numbers) != 4:
            return 0.0, 0.0, width, height
        left, top, across, down = (float(number) for number in numbers)
        return left, top, across, down

    def draw(
        self,
        scale: float = 1.0,
        *,
        window: tuple[int, int, int, int] | None = None,
        smooth: bool = True,
        content: Sequence[ElementTree.Element] | None = None,
    ) -> np.ndarray:
        """(H, W, 4) uint8 straight RGBA of the canvas, or of a window (left, top, width, height in px), by resvg.

        scale: of the canvas's px. smooth: whether edges are anti-aliased; else a px is what lies at its middle.
        content: what is drawn in the document's place of all that it holds.
        """
        left, top, width, height = window or (0, 0, self.width, self.height)
        pixels = (round(width * scale), round(height * scale))
        corner = (self.origin[0] + left * self.unit, self.origin[1] + top * self.unit)
        box = (*corner, width * self.unit, height * self.unit)
        view = {"width": str(pixels[0]), "height": str(pixels[1]), "viewBox": " ".join(f"{n:.12g}" for n in box)}
        if not smooth:
            view["shape-rendering"] = "crispEdges"
        root = ElementTree.Element(self.root.tag, {**self.root.attrib, **view})
        root.attrib.pop("preserveAspectRatio", None)
        root.extend(self.root if content is None else content)
        return rerender(ElementTree.tostring(root), *pixels, renderer="resvg").pixels


def local_name(element: ElementTree.Element) -> str:
    """The element's name without its namespace; empty for comments."""
    return element.tag.rpartition("}")[2] if isinstance(element.tag, str) else ""
