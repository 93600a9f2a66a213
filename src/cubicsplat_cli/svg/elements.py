"""The shapes that an SVG of any origin draws, in order, with resolved styles and transforms.

Groups, uses and nested canvases are followed. Styles come from attributes, `style=`, and the rules of style sheets that
name a class, an id or an element.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import TypeVar
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.record import record
from cubicsplat_cli.svg.values import Rgba, colour, parse_length, share, transform_matrix, translation

SVG = "{http://www.w3.org/2000/svg}"
XLINK_HREF = "{http://www.w3.org/1999/xlink}href"
NOT_DRAWN = {
    "defs", "title", "desc", "metadata", "style", "script", "linearGradient", "radialGradient", "symbol", "view",
    "clipPath", "mask", "pattern", "filter", "marker",
}  # fmt: skip
SHAPES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")
_GROUPS = ("svg", "g", "a", "switch")
_WIDE, _HIGH = ("x", "width", "cx", "rx", "x1", "x2"), ("y", "height", "cy", "ry", "y1", "y2")
_MOST_ELEMENTS, _DEEPEST = 200_000, 256  # drawn, those of a use once for each time
_INHERITED = {
    "fill": "black", "fill-opacity": "1", "fill-rule": "nonzero", "stroke": "none", "stroke-width": "1",
    "stroke-opacity": "1", "stroke-linecap": "butt", "stroke-linejoin": "miter", "stroke-miterlimit": "4",
    "stroke-dasharray": "none", "color": "black", "visibility": "visible",
}  # fmt: skip
_EFFECTS = ("clip-path", "mask", "filter")
_PROPERTIES = (*_INHERITED, "opacity", "display", *_EFFECTS)
_RULE = re.compile(r"([^{}]+)\{([^{}]*)\}")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_REFERENCE = re.compile(r"url\(\s*['\"]?#([^'\")]+)['\"]?\s*\)\s*(.*)")
LEAST_OPACITY = 1.0 / 512.0  # below it nothing shows in 8 bits
Paint = TypeVar("Paint")
_SELECTOR = re.compile(r"([\w-]+|\*)?(?:([.#])([\w-]+))?")


@record
class StyledShape:
    """A shape that is drawn.

    element: as written. above: the groups around it without the root, the outermost first; a `use` is a group too.
    style: its properties, inherited ones included. matrix: (3, 3) from its own units to px of the whole drawing.
    opacity: the product of its own and those of the groups. view: width and height that percentages refer to.
    """

    element: ElementTree.Element
    above: tuple[ElementTree.Element, ...]
    style: Mapping[str, str]
    matrix: np.ndarray
    opacity: float
    view: tuple[float, float]

    @property
    def name(self) -> str:
        return local_name(self.element)

    def length(self, attribute: str) -> float:
        """An attribute in user units, 0 where there is none; ValueError where it is no length."""
        across, down = self.view
        whole = across if attribute in _WIDE else down if attribute in _HIGH else ((across**2 + down**2) / 2.0) ** 0.5
        return parse_length(self.element.get(attribute, "0"), whole)

    def path_data(self) -> str:
        """Its outline as path data in its own units. Raises ValueError where a length of it cannot be read."""
        return _path_data(self.name, self.length, self.element.attrib)

    def paint(self, name: str, server: Callable[[str], Paint | None]) -> tuple[Rgba | Paint | None, float]:
        """The paint of a "fill" or "stroke", None where there is none to be seen, and the opacity it is drawn with.

        server: gives the paint of an id that is referred to, None where it has none. Raises ValueError for a colour
        or an opacity that cannot be read.
        """
        text, current = self.style[name], self.style["color"]
        match = _REFERENCE.fullmatch(text)
        paint: Rgba | Paint | None = colour(text, current) if match is None else server(match[1])
        if paint is None and match is not None and match[2]:
            paint = colour(match[2], current)
        opacity = share(self.style[f"{name}-opacity"]) * self.opacity
        return (paint, opacity) if paint is not None and opacity >= LEAST_OPACITY else (None, 0.0)


@record
class _Context:
    """The state that the elements in a group inherit."""

    matrix: np.ndarray
    style: dict[str, str]
    view: tuple[float, float]
    opacity: float = 1.0
    above: tuple[ElementTree.Element, ...] = ()
    depth: int = 0


class StyledTree:
    """A document with its style sheets. named: its elements by their ids. left_out: what is not drawn of it, and how
    many of each.
    """

    def __init__(self, root: ElementTree.Element, left_out: Counter[str] | None = None) -> None:
        """Raises InputError for a document of too many shapes."""
        self.root = root
        self.left_out = Counter() if left_out is None else left_out
        self.named = {element.get("id", ""): element for element in root.iter()}
        if sum(local_name(element) in SHAPES for element in root.iter()) > _MOST_ELEMENTS:
            raise InputError(f"draws more than {_MOST_ELEMENTS} elements; simplify it")
        self._rules = _rules_of(root, self.left_out)
        self._elements = 0

    def shapes(self, width: float, height: float) -> Iterator[StyledShape]:
        """All shapes, the first at the back, of the document drawn at width x height px.

        Raises ValueError for a length, number or transform that is none, InputError for a document without end.
        """
        yield from self._in(self.root, _Context(np.eye(3), dict(_INHERITED), (width, height)))

    def declared(self, element: ElementTree.Element) -> dict[str, str]:
        """The values declared for an element itself, from attributes, rules and `style=`, the last the strongest."""
        name, classes = local_name(element), element.get("class", "").split()
        values = dict(element.attrib)
        for _, of, kind, value, declarations in self._rules:
            matches = not kind or (value in classes if kind == "." else value == element.get("id"))
            if matches and of in ("*", name):
                values |= declarations
        return values | _declarations(element.get("style", ""))

    def _in(self, element: ElementTree.Element, outer: _Context) -> Iterator[StyledShape]:
        """An element that is drawn, and what is in it."""
        name = local_name(element)
        self._elements += 1
        if self._elements > _MOST_ELEMENTS or outer.depth > _DEEPEST:
            raise InputError(f"draws more than {_MOST_ELEMENTS} elements, or {_DEEPEST} in one another; simplify it")
        declared = self.declared(element)
        own = {key: declared[key] for key in _PROPERTIES if declared.get(key, "inherit") != "inherit"}
        if own.get("display") == "none":
            return
        for effect in _EFFECTS:
            self.left_out[effect] += own.get(effect, "none") != "none"
        inner = replace(
            outer,
            matrix=outer.matrix @ transform_matrix(element.get("transform", "")),
            style={key: own.get(key, value) for key, value in outer.style.items()},
            opacity=outer.opacity * share(own.get("opacity", "1")),
            depth=outer.depth + 1,
        )
        if name in SHAPES:
            if inner.style["visibility"] == "visible" and inner.opacity > 0.0:
                yield StyledShape(element, inner.above, inner.style, inner.matrix, inner.opacity, inner.view)
        elif name == "use":
            yield from self._used(element, inner)
        elif name in _GROUPS:
            if name == "svg":
                matrix, view = _canvas(element, inner.matrix, inner.view, nested=outer.depth > 0)
                inner = replace(inner, matrix=matrix, view=view)
            yield from self._children(element, inner, above=outer.depth > 0)

    def _children(self, element: ElementTree.Element, inner: _Context, *, above: bool) -> Iterator[StyledShape]:
        if above:
            inner = replace(inner, above=(*inner.above, element))
        for child in element:
            kind = local_name(child)
            if kind in (*SHAPES, *_GROUPS, "use"):
                yield from self._in(child, inner)
            elif kind and kind not in NOT_DRAWN:
                self.left_out[kind] += 1

    def _used(self, use: ElementTree.Element, inner: _Context) -> Iterator[StyledShape]:
        target = self.named.get(reference(use))
        if target is None or target is use:
            self.left_out["use of nothing"] += 1
            return
        x, y = (parse_length(use.get(name, "0"), whole) for name, whole in zip(("x", "y"), inner.view, strict=True))
        kept = {k: v for k, v in use.attrib.items() if k not in (XLINK_HREF, "href", "x", "y", "width", "height", "id")}
        move = f"{use.get('transform', '')}translate({x!r} {y!r})"
        group = ElementTree.Element(f"{SVG}g", kept | {"transform": move})
        inner = replace(inner, matrix=inner.matrix @ translation(x, y), above=(*inner.above, group))
        if local_name(target) in ("svg", "symbol"):
            sizes = {name: use.get(name, "") for name in ("width", "height") if use.get(name)}
            canvas = ElementTree.Element(f"{SVG}svg", target.attrib | sizes)
            canvas.extend(target)
            target = canvas
        yield from self._in(target, inner)


def local_name(element: ElementTree.Element) -> str:
    """An element's name; empty for one of another language, and for comments."""
    tag = str(element.tag)
    return tag.removeprefix(SVG) if tag.startswith(SVG) or not tag.startswith("{") else ""


def reference(element: ElementTree.Element) -> str:
    """The id that an element refers to, empty where it does not."""
    return (element.get("href") or element.get(XLINK_HREF) or "").removeprefix("#")


def _canvas(
    element: ElementTree.Element, matrix: np.ndarray, view: tuple[float, float], *, nested: bool
) -> tuple[np.ndarray, tuple[float, float]]:
    """The matrix inside an element with a viewBox, and the size of that; the box is fitted in and centred."""
    width, height = view
    if nested:
        x, y = (parse_length(element.get(name, "0"), whole) for name, whole in zip(("x", "y"), view, strict=True))
        matrix = matrix @ translation(x, y)
        width, height = (
            parse_length(element.get(n, "100%"), w) for n, w in zip(("width", "height"), view, strict=True)
        )
    box = [float(part) for part in element.get("viewBox", "").replace(",", " ").split()]
    if len(box) != 4 or min(box[2:]) <= 0.0:
        return matrix, (width, height)
    across, down = width / box[2], height / box[3]
    if not element.get("preserveAspectRatio", "").startswith("none"):
        across = down = min(across, down)
    x, y = (width - across * box[2]) / 2.0 - across * box[0], (height - down * box[3]) / 2.0 - down * box[1]
    return matrix @ translation(x, y) @ np.diag([across, down, 1.0]), (box[2], box[3])


_Rule = tuple[int, str, str, str, dict[str, str]]  # specificity; name, kind and value of its selector; declarations


def _rules_of(root: ElementTree.Element, left_out: Counter[str]) -> list[_Rule]:
    """The rules of all style sheets, the strongest last; those with selectors of more than one name are left out."""
    rules: list[_Rule] = []
    for element in root.iter():
        if str(element.tag).rpartition("}")[2] != "style":
            continue
        for selectors, body in _RULE.findall(_COMMENT.sub("", "".join(element.itertext()))):
            for selector in selectors.split(","):
                match = _SELECTOR.fullmatch(selector.strip())
                if match is None or not match[0]:
                    left_out["style rule"] += 1
                    continue
                name, kind, value = (group or "" for group in match.groups())
                rules.append(({".": 1, "#": 2}.get(kind, 0), name or "*", kind, value, _declarations(body)))
    return sorted(rules, key=lambda rule: rule[0])


def _declarations(text: str) -> dict[str, str]:
    """`fill: red; stroke: none` as values by name."""
    pairs = (part.partition(":") for part in text.split(";"))
    return {name.strip(): value.replace("!important", "").strip() for name, _, value in pairs if value.strip()}


def _path_data(name: str, length: Callable[[str], float], attributes: Mapping[str, str]) -> str:
    """The path data of a shape in SHAPES; empty where it has no extent."""
    if name == "path":
        return attributes.get("d", "")
    if name == "line":
        return f"M{length('x1')!r} {length('y1')!r}L{length('x2')!r} {length('y2')!r}"
    if name in ("polyline", "polygon"):
        points = attributes.get("points", "").strip()
        return f"M{points}{'Z' if name == 'polygon' else ''}" if points else ""
    if name == "rect":
        return _rectangle(length, attributes)
    rx, ry = (length("r"), length("r")) if name == "circle" else (length("rx"), length("ry"))
    if min(rx, ry) <= 0.0:
        return ""
    x, y, arc = length("cx"), length("cy"), f"A{rx!r} {ry!r} 0 0 1 "
    return f"M{x + rx!r} {y!r}{arc}{x - rx!r} {y!r}{arc}{x + rx!r} {y!r}Z"


def _rectangle(length: Callable[[str], float], attributes: Mapping[str, str]) -> str:
    x, y, width, height = (length(name) for name in ("x", "y", "width", "height"))
    if min(width, height) <= 0.0:
        return ""
    rx = length("rx" if "rx" in attributes else "ry")
    ry = length("ry" if "ry" in attributes else "rx")
    rx, ry = min(rx, width / 2.0), min(ry, height / 2.0)
    right, bottom = x + width, y + height
    if min(rx, ry) <= 0.0:
        return f"M{x!r} {y!r}H{right!r}V{bottom!r}H{x!r}Z"
    arc = f"A{rx!r} {ry!r} 0 0 1 "
    return (
        f"M{x + rx!r} {y!r}H{right - rx!r}{arc}{right!r} {y + ry!r}V{bottom - ry!r}{arc}{right - rx!r} {bottom!r}"
        f"H{x + rx!r}{arc}{x!r} {bottom - ry!r}V{y + ry!r}{arc}{x + rx!r} {y!r}Z"
    )
