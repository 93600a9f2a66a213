"""The shapes that an SVG of any origin draws, in order, with resolved styles and transforms.

Groups, uses and nested canvases are followed. Styles come from attributes, `style=`, and the rules of style sheets that
name a class, an id or an element.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.record import record
from cubicsplat_cli.svg.values import parse_length, share, transform_matrix, translation

SVG = "{http://www.w3.org/2000/svg}"
ElementTree.register_namespace("", SVG[1:-1])  # elements are written without a prefix
XLINK_HREF = "{http://www.w3.org/1999/xlink}href"
NOT_DRAWN = {
    "defs", "title", "desc", "metadata", "style", "script", "linearGradient", "radialGradient", "symbol", "view",
    "clipPath", "mask", "pattern", "filter", "marker",
}  # fmt: skip
SHAPES = ("path", "rect", "circle", "ellipse", "line", "polyline", "polygon")
_GROUPS = ("svg", "g", "a", "switch")
_WIDE, _HIGH = ("x", "width", "cx", "rx", "x1", "x2"), ("y", "height", "cy", "ry", "y1", "y2")
_MOST_ELEMENTS, _DEEPEST = 200_000, 256  # elements that are drawn, those of a use once for each time
_INHERITED = {
    "fill": "black", "fill-opacity": "1", "fill-rule": "nonzero", "stroke": "none", "stroke-width": "1",
    "stroke-opacity": "1", "stroke-linecap": "butt", "stroke-linejoin": "miter", "stroke-miterlimit": "4",
    "stroke-dasharray": "none", "stroke-dashoffset": "0", "color": "black", "visibility": "visible",
}  # fmt: skip
_EFFECTS = ("clip-path", "mask", "filter")
_PROPERTIES = (*_INHERITED, "opacity", "display", *_EFFECTS)
_RULE = re.compile(r"([^{}]+)\{([^{}]*)\}")
_COMMENT = re.compile(r"/\*.*?\*/", re.DOTALL)
_SELECTOR = re.compile(r"([\w-]+|\*)?(?:([.#])([\w-]+))?")


@record
class StyledShape:
    """A shape that is drawn, or, while a document is followed, any element around it.

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

    def length(self, attribute: str, default: str = "0") -> float:
        """Return an attribute in user units. Raises ValueError if it is no length."""
        across, down = self.view
        whole = across if attribute in _WIDE else down if attribute in _HIGH else ((across**2 + down**2) / 2.0) ** 0.5
        return parse_length(self.element.get(attribute, default), whole)

    def path_data(self) -> str:
        """Return the outline as path data in its own units, empty without extent. Raises ValueError for bad lengths."""
        name, length = self.name, self.length
        if name == "path":
            return self.element.get("d", "")
        if name == "line":
            return f"M{length('x1')!r} {length('y1')!r}L{length('x2')!r} {length('y2')!r}"
        if name in ("polyline", "polygon"):
            points = self.element.get("points", "").strip()
            return f"M{points}{'Z' if name == 'polygon' else ''}" if points else ""
        if name == "rect":
            return self._rectangle()
        rx, ry = (length("r"), length("r")) if name == "circle" else (length("rx"), length("ry"))
        if min(rx, ry) <= 0.0:
            return ""
        x, y, arc = length("cx"), length("cy"), f"A{rx!r} {ry!r} 0 0 1 "
        return f"M{x + rx!r} {y!r}{arc}{x - rx!r} {y!r}{arc}{x + rx!r} {y!r}Z"

    def _rectangle(self) -> str:
        x, y, width, height = (self.length(name) for name in ("x", "y", "width", "height"))
        if min(width, height) <= 0.0:
            return ""
        given = self.element.attrib
        rx, ry = self.length("rx" if "rx" in given else "ry"), self.length("ry" if "ry" in given else "rx")
        rx, ry = min(rx, width / 2.0), min(ry, height / 2.0)
        right, bottom = x + width, y + height
        if min(rx, ry) <= 0.0:
            return f"M{x!r} {y!r}H{right!r}V{bottom!r}H{x!r}Z"
        arc = f"A{rx!r} {ry!r} 0 0 1 "
        return (
            f"M{x + rx!r} {y!r}H{right - rx!r}{arc}{right!r} {y + ry!r}V{bottom - ry!r}{arc}{right - rx!r} {bottom!r}"
            f"H{x + rx!r}{arc}{x!r} {bottom - ry!r}V{y + ry!r}{arc}{x + rx!r} {y!r}Z"
        )


class StyledTree:
    """A document with its style sheets. named: its elements by id. left_out: kinds of what is not drawn, counted."""

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
        """Yield all shapes, the first at the back, of the document drawn at width x height px.

        Raises ValueError for a length, number or transform that cannot be read, InputError for too many elements.
        """
        yield from self._in(self.root, StyledShape(self.root, (), _INHERITED, np.eye(3), 1.0, (width, height)))

    def declared(self, element: ElementTree.Element) -> dict[str, str]:
        """Return the values declared for an element, from attributes, rules and `style=`, the last the strongest."""
        name, classes = local_name(element), element.get("class", "").split()
        values = dict(element.attrib)
        for _, of, kind, value, declarations in self._rules:
            matches = not kind or (value in classes if kind == "." else value == element.get("id"))
            if matches and of in ("*", name):
                values |= declarations
        return values | _declarations(element.get("style", ""))

    def _in(self, element: ElementTree.Element, outer: StyledShape) -> Iterator[StyledShape]:
        """Yield the shapes of an element. outer: the element around it."""
        self._elements += 1
        if self._elements > _MOST_ELEMENTS or len(outer.above) >= _DEEPEST:
            raise InputError(f"draws more than {_MOST_ELEMENTS} elements, or {_DEEPEST} in one another; simplify it")
        declared = self.declared(element)
        given = {key: declared[key] for key in _PROPERTIES if declared.get(key, "inherit") != "inherit"}
        if given.get("display") == "none":
            return
        for effect in _EFFECTS:
            self.left_out[effect] += given.get(effect, "none") != "none"
        inner = replace(
            outer,
            element=element,
            matrix=outer.matrix @ transform_matrix(element.get("transform", "")),
            style={key: given.get(key, value) for key, value in outer.style.items()},
            opacity=outer.opacity * share(given.get("opacity", "1")),
        )
        if inner.name in SHAPES:
            if inner.style["visibility"] == "visible" and inner.opacity > 0.0:
                yield inner
        elif inner.name == "use":
            yield from self._used(inner)
        elif inner.name in _GROUPS:
            if inner.name == "svg":
                inner = _canvas(inner, nested=element is not self.root)
            if element is not self.root:
                inner = replace(inner, above=(*inner.above, element))
            for child in element:
                kind = local_name(child)
                if kind in (*SHAPES, *_GROUPS, "use"):
                    yield from self._in(child, inner)
                elif kind and kind not in NOT_DRAWN:
                    self.left_out[kind] += 1

    def _used(self, shape: StyledShape) -> Iterator[StyledShape]:
        """Yield the shapes that a `use` refers to."""
        use = shape.element
        target = self.named.get(reference(use))
        if target is None or target is use:
            self.left_out["use of nothing"] += 1
            return
        x, y = shape.length("x"), shape.length("y")
        kept = {k: v for k, v in use.attrib.items() if k not in (XLINK_HREF, "href", "x", "y", "width", "height", "id")}
        move = f"{use.get('transform', '')}translate({x!r} {y!r})"
        group = ElementTree.Element(f"{SVG}g", kept | {"transform": move})
        inner = replace(shape, matrix=shape.matrix @ translation(x, y), above=(*shape.above, group))
        if local_name(target) in ("svg", "symbol"):
            sizes = {name: use.get(name, "") for name in ("width", "height") if use.get(name)}
            canvas = ElementTree.Element(f"{SVG}svg", target.attrib | sizes)
            canvas.extend(target)
            target = canvas
        yield from self._in(target, inner)


def local_name(element: ElementTree.Element) -> str:
    """Return an element's name, empty for one of another language and for comments."""
    tag = str(element.tag)
    return tag.removeprefix(SVG) if tag.startswith(SVG) or not tag.startswith("{") else ""


def reference(element: ElementTree.Element) -> str:
    """Return the id that an element refers to, empty if there is none."""
    return (element.get("href") or element.get(XLINK_HREF) or "").removeprefix("#")


def _canvas(shape: StyledShape, *, nested: bool) -> StyledShape:
    """Return an `svg` with the matrix and the view inside; its viewBox is fitted in and centred."""
    matrix, (width, height) = shape.matrix, shape.view
    if nested:
        matrix = matrix @ translation(shape.length("x"), shape.length("y"))
        width, height = shape.length("width", "100%"), shape.length("height", "100%")
    box = [float(part) for part in shape.element.get("viewBox", "").replace(",", " ").split()]
    if len(box) != 4 or min(box[2:]) <= 0.0:
        return replace(shape, matrix=matrix, view=(width, height))
    across, down = width / box[2], height / box[3]
    if not shape.element.get("preserveAspectRatio", "").startswith("none"):
        across = down = min(across, down)
    x, y = (width - across * box[2]) / 2.0 - across * box[0], (height - down * box[3]) / 2.0 - down * box[1]
    return replace(shape, matrix=matrix @ translation(x, y) @ np.diag([across, down, 1.0]), view=(box[2], box[3]))


_Rule = tuple[int, str, str, str, dict[str, str]]  # specificity; name, kind and value of its selector; declarations


def _rules_of(root: ElementTree.Element, left_out: Counter[str]) -> list[_Rule]:
    """Return the rules of all style sheets, the strongest last, except those with selectors of more than one name."""
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
                name, kind, value = match.groups("")
                rules.append(({".": 1, "#": 2}.get(kind, 0), name or "*", kind, value, _declarations(body)))
    return sorted(rules, key=lambda rule: rule[0])


def _declarations(text: str) -> dict[str, str]:
    """Return the values of a text such as `fill: red; stroke: none` by their names."""
    pairs = (part.partition(":") for part in text.split(";"))
    return {name.strip(): value.replace("!important", "").strip() for name, _, value in pairs if value.strip()}
