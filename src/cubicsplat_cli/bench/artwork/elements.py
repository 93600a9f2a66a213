"""The drawn elements of a document in their order, each of which can be drawn on its own."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from xml.etree import ElementTree

from cubicsplat_cli.bench.artwork.document import local_name

SHAPES = {"circle", "ellipse", "rect", "line", "path", "polygon", "polyline"}
NOT_DRAWN = {"defs", "clipPath", "mask", "symbol", "marker", "pattern", "linearGradient", "radialGradient", "metadata"}
_MOST_USES = 100_000
_DEEPEST_USE = 8
_HREF = "{http://www.w3.org/1999/xlink}href"


@dataclass(frozen=True, eq=False)
class Drawn:
    """A shape that is drawn. element: it. above: what it stands in, the outermost first, the root left out; of a `use`
    a group with its place. fill, stroke: its paints as written, "none" where there is none.
    """

    element: ElementTree.Element
    above: tuple[ElementTree.Element, ...]
    fill: str
    stroke: str

    def alone(self, part: str) -> ElementTree.Element:
        """The element with nothing but its groups around it, and only its "fill" or its "stroke" drawn."""
        other = {"fill": "stroke", "stroke": "fill"}[part]
        found = ElementTree.Element(self.element.tag, dict(self.element.attrib))
        style = self.element.get("style", "").rstrip("; ")
        found.set("style", f"{style};{other}:none".lstrip(";"))
        for group in reversed(self.above):
            shell = ElementTree.Element(group.tag, dict(group.attrib))
            shell.append(found)
            found = shell
        return found


def drawn_elements(root: ElementTree.Element) -> Iterator[Drawn]:
    """Every shape that is drawn, in the order of drawing; those of a `use` once for each time."""
    named = {element.get("id"): element for element in root.iter() if element.get("id")}
    waiting: list[tuple[ElementTree.Element, tuple[ElementTree.Element, ...], dict[str, str], int]]
    waiting = [(root, (), {"fill": "black", "stroke": "none"}, 0)]
    budget = _MOST_USES
    while waiting and budget:
        element, above, paint, depth = waiting.pop()
        name = local_name(element)
        if name in NOT_DRAWN and (depth == 0 or name != "symbol"):
            continue
        paint = _paint(element, paint)
        if name in SHAPES:
            if set(paint.values()) != {"none"}:
                budget -= 1
                yield Drawn(element, above, paint["fill"], paint["stroke"])
            continue
        if name == "use":
            target = named.get((element.get(_HREF) or element.get("href") or "").removeprefix("#"))
            if target is not None and depth < _DEEPEST_USE:
                waiting.append((target, (*above, _place(element)), paint, depth + 1))
            continue
        inner = above if element is root else (*above, element)
        waiting += [(child, inner, paint, depth) for child in reversed(element)]


def resources(root: ElementTree.Element) -> list[ElementTree.Element]:
    """What shapes may refer to: definitions, clips, gradients, styles."""
    found, waiting = [], list(root)
    while waiting:
        element = waiting.pop(0)
        if local_name(element) in (*NOT_DRAWN, "style", "filter"):
            found.append(element)
        else:
            waiting += list(element)
    return found


def _place(use: ElementTree.Element) -> ElementTree.Element:
    """A group in the place of a `use`."""
    kept = {k: v for k, v in use.attrib.items() if k not in (_HREF, "href", "x", "y", "width", "height", "id")}
    move = f"translate({use.get('x', '0')} {use.get('y', '0')})"
    return ElementTree.Element(use.tag.replace("use", "g"), kept | {"transform": f"{use.get('transform', '')}{move}"})


def _paint(element: ElementTree.Element, inherited: dict[str, str]) -> dict[str, str]:
    """Fill and stroke as attributes and the style attribute give them, else as inherited."""
    paint = {name: element.get(name, value) for name, value in inherited.items()}
    for declaration in element.get("style", "").split(";"):
        name, _, value = (part.strip() for part in declaration.partition(":"))
        if name in paint:
            paint[name] = value
    return paint
