"""The shapes that a document draws, in their order: through groups, uses and nested canvases."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.beginning.outlines import SHAPES
from cubicsplat_cli.beginning.styles import INHERITED, PROPERTIES, Sheet, declarations, length, share
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.svg.transforms import transform_matrix

_SVG = "{http://www.w3.org/2000/svg}"
_HREFS = ("href", "{http://www.w3.org/1999/xlink}href")
_GROUPS = ("svg", "g", "a", "switch", "symbol")
_NOT_DRAWN = {
    "defs", "title", "desc", "metadata", "style", "script", "linearGradient", "radialGradient", "symbol", "view",
    "clipPath", "mask", "pattern", "filter", "marker",
}  # fmt: skip
_WIDE, _HIGH = ("x", "width", "cx", "rx", "x1", "x2"), ("y", "height", "cy", "ry", "y1", "y2")
_MOST_ELEMENTS, _DEEPEST = 200_000, 256  # drawn, those of a use once for each time


@dataclass(frozen=True, eq=False)
class Drawn:
    """A shape: its name, attributes, style, the matrix (3, 3) to px of the canvas, and the product of the opacities."""

    name: str
    attributes: Mapping[str, str]
    style: dict[str, str]
    matrix: np.ndarray
    opacity: float
    view: tuple[float, float]  # what percentages are of

    def length(self, attribute: str) -> float:
        """An attribute in user units, 0 where there is none; ValueError where it is no length."""
        across, down = self.view
        whole = across if attribute in _WIDE else down if attribute in _HIGH else ((across**2 + down**2) / 2.0) ** 0.5
        return length(self.attributes.get(attribute, "0"), whole)


def local(element: ElementTree.Element) -> str:
    """An element's name; empty for one of another language."""
    tag = str(element.tag)
    return tag.removeprefix(_SVG) if tag.startswith(_SVG) or not tag.startswith("{") else ""


class Elements:
    """Goes through a document. left_out: what is not drawn, and how many of each."""

    def __init__(self, root: ElementTree.Element, left_out: Counter[str]) -> None:
        self.root, self.left_out = root, left_out
        self.named = {element.get("id", ""): element for element in root.iter()}
        if sum(local(element) in SHAPES for element in root.iter()) > _MOST_ELEMENTS:
            raise InputError(f"draws more than {_MOST_ELEMENTS} elements; simplify it")
        self._sheet = Sheet(root, left_out)
        self._elements = 0

    def shapes(self, width: float, height: float) -> Iterator[Drawn]:
        """All shapes, the first at the back, of the document drawn at width x height px.

        Raises ValueError for a length, number or transform that is none, InputError for a document without end.
        """
        yield from self._inside(self.root, np.eye(3), dict(INHERITED), 1.0, (width, height), 0)

    def _inside(
        self, element: ElementTree.Element, matrix: np.ndarray, inherited: dict[str, str], opacity: float,
        view: tuple[float, float], depth: int,
    ) -> Iterator[Drawn]:  # fmt: skip
        """An element that is drawn, and what is in it. view: the size of the canvas that it is on."""
        name = local(element)
        said = self._style(element)
        self._elements += 1
        if self._elements > _MOST_ELEMENTS or depth > _DEEPEST:
            raise InputError(f"draws more than {_MOST_ELEMENTS} elements, or {_DEEPEST} in one another; simplify it")
        if said.get("display") == "none":
            return
        style = {key: said.get(key, value) for key, value in inherited.items()}
        for effect in ("clip-path", "mask", "filter"):
            self.left_out[effect] += said.get(effect, "none") != "none"
        opacity *= share(said.get("opacity", "1"))
        matrix = matrix @ transform_matrix(element.get("transform", ""))
        if name in ("svg", "symbol"):
            matrix, view = _canvas(element, matrix, view, nested=depth > 0)
        if name in SHAPES:
            if style["visibility"] == "visible" and opacity > 0.0:
                yield Drawn(name, element.attrib, style, matrix, opacity, view)
        elif name == "use":
            yield from self._used(element, matrix, style, opacity, view, depth)
        elif name in _GROUPS:
            for child in element:
                kind = local(child)
                if kind in (*SHAPES, *_GROUPS, "use") and kind != "symbol":
                    yield from self._inside(child, matrix, style, opacity, view, depth + 1)
                elif kind and kind not in _NOT_DRAWN:
                    self.left_out[kind] += 1

    def _used(
        self, use: ElementTree.Element, matrix: np.ndarray, style: dict[str, str], opacity: float,
        view: tuple[float, float], depth: int,
    ) -> Iterator[Drawn]:  # fmt: skip
        target = self.named.get(reference(use))
        if target is None or target is use:
            self.left_out["use of nothing"] += 1
            return
        across, down = (length(use.get(name, "0"), whole) for name, whole in zip(("x", "y"), view, strict=True))
        placed = matrix @ np.array([[1.0, 0.0, across], [0.0, 1.0, down], [0.0, 0.0, 1.0]])
        if local(target) in ("svg", "symbol"):
            sizes = {name: use.get(name) for name in ("width", "height") if use.get(name)}
            target = _with(target, sizes)
        yield from self._inside(target, placed, style, opacity, view, depth + 1)

    def said_by_rules(self, element: ElementTree.Element) -> dict[str, str]:
        """What style sheets say of an element."""
        return self._sheet.of(local(element), element.attrib)

    def _style(self, element: ElementTree.Element) -> dict[str, str]:
        """What is said of an element itself: by attributes, over these rules, over these its own style."""
        said = {key: element.attrib[key] for key in PROPERTIES if key in element.attrib}
        said |= self.said_by_rules(element)
        said |= declarations(element.get("style", ""))
        return {key: value for key, value in said.items() if value != "inherit"}


def reference(element: ElementTree.Element) -> str:
    """The id that an element refers to, empty where it does not."""
    return next((element.get(name, "") for name in _HREFS if element.get(name)), "").removeprefix("#")


def _with(element: ElementTree.Element, attributes: Mapping[str, str | None]) -> ElementTree.Element:
    copy = ElementTree.Element(element.tag, {**element.attrib, **{k: v for k, v in attributes.items() if v}})
    copy.extend(element)
    return copy


def _canvas(
    element: ElementTree.Element, matrix: np.ndarray, view: tuple[float, float], *, nested: bool
) -> tuple[np.ndarray, tuple[float, float]]:
    """The matrix inside an element with a viewBox, and the size of that; the box is fitted in and centred."""
    width, height = view
    if nested:
        places = [length(element.get(name, "0"), whole) for name, whole in zip(("x", "y"), view, strict=True)]
        matrix = matrix @ np.array([[1.0, 0.0, places[0]], [0.0, 1.0, places[1]], [0.0, 0.0, 1.0]])
        width, height = (length(element.get(n, "100%"), w) for n, w in zip(("width", "height"), view, strict=True))
    box = [float(part) for part in element.get("viewBox", "").replace(",", " ").split()]
    if len(box) != 4 or min(box[2:]) <= 0.0:
        return matrix, (width, height)
    across, down = width / box[2], height / box[3]
    if element.get("preserveAspectRatio", "").startswith("none"):
        scale = np.array([across, down])
    else:
        scale = np.full(2, min(across, down))
    shift = (np.array([width, height]) - scale * box[2:]) / 2.0 - scale * box[:2]
    fitted = np.array([[scale[0], 0.0, shift[0]], [0.0, scale[1], shift[1]], [0.0, 0.0, 1.0]])
    return matrix @ fitted, (box[2], box[3])
