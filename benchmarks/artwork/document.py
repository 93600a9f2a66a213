"""An SVG document that can be drawn at any scale, in parts, with or without anti-aliasing, and by its elements."""

from __future__ import annotations

import math
from collections.abc import Sequence
from fnmatch import fnmatch
from pathlib import Path
from typing import Annotated
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.cli.options import argument, option
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.files.names import files_in
from cubicsplat_cli.options import Setting
from cubicsplat_cli.svg.elements import NOT_DRAWN, StyledShape, StyledTree, local_name
from cubicsplat_cli.svg.untrusted import check_untrusted

SIZE = Setting("count", "", least=16, most=2048)  # px of the longer side
Drawings = Annotated[Path, argument("DIR", "Folder of SVG drawings.")]
Size = Annotated[int, option("--size PX", "Longer side of the input.")]
Only = Annotated[str | None, option("--only PATTERN,...", "Only drawings of these names, as in 'flag-*'.")]
Skip = Annotated[str | None, option("--skip PATTERN,...", "None of these names.")]

# Numbers that describe each primitive; a rect has one more where its corners are round.
PRIMITIVES = {"circle": 3, "ellipse": 4, "rect": 4, "line": 4}

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
        box = [float(number) for number in self.root.get("viewBox", "").replace(",", " ").split()]
        left, top, across, down = box if len(box) == 4 else (0.0, 0.0, size.width, size.height)
        self.origin = (left, top)
        self.unit = across / size.width if longest is None else max(across, down) / longest
        self.width = max(1, math.floor(across / self.unit + 1e-6))
        self.height = max(1, math.floor(down / self.unit + 1e-6))

    def draw(
        self,
        scale: float = 1.0,
        *,
        window: tuple[int, int, int, int] | None = None,
        smooth: bool = True,
        renderer: str = "resvg",
        content: Sequence[ElementTree.Element] | None = None,
    ) -> np.ndarray:
        """(H, W, 4) uint8 straight RGBA of the canvas, or of a window (left, top, width, height in px).

        scale: of the canvas's px. smooth: whether edges are anti-aliased; else a px has the colour at its centre.
        content: drawn in place of the document's own elements.
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
        return rerender(ElementTree.tostring(root), *pixels, renderer=renderer).pixels

    def shapes(self) -> list[StyledShape]:
        """Every shape with a fill or a stroke, those of a `use` once for each time, in px of the canvas."""
        left, top = self.origin
        box = f"{left!r} {top!r} {self.width * self.unit!r} {self.height * self.unit!r}"
        root = ElementTree.Element(self.root.tag, self.root.attrib | {"viewBox": box})
        root.extend(self.root)
        shapes = StyledTree(root).shapes(self.width, self.height)
        return [shape for shape in shapes if (shape.style["fill"], shape.style["stroke"]) != ("none", "none")]


def alone(shape: StyledShape, part: str) -> ElementTree.Element:
    """The element of a shape with nothing but its groups around it, and only its "fill" or its "stroke" drawn."""
    other = {"fill": "stroke", "stroke": "fill"}[part]
    branch = ElementTree.Element(shape.element.tag, dict(shape.element.attrib))
    style = shape.element.get("style", "").rstrip("; ")
    branch.set("style", f"{style};{other}:none".lstrip(";"))
    for group in reversed(shape.above):
        shell = ElementTree.Element(group.tag, dict(group.attrib))
        shell.append(branch)
        branch = shell
    return branch


def drawings_in(folder: Path, only: str | None, skip: str | None, limit: int | None) -> list[Path]:
    """The SVG files right in a folder by name, those whose stem matches `only` and not `skip` (shell patterns, several
    with commas between them). Raises InputError where there is none, or the folder cannot be read.
    """
    found = files_in(folder, lambda path: path.suffix.lower() == ".svg")
    chosen = [p for p in found if (only is None or _matches(p, only)) and not (skip is not None and _matches(p, skip))]
    if not chosen:
        raise InputError(f"{folder}: holds no SVG that is asked for; give a folder of drawings")
    return chosen[:limit]


def _matches(path: Path, patterns: str) -> bool:
    return any(fnmatch(path.stem, pattern.strip()) for pattern in patterns.split(","))


def resources(root: ElementTree.Element) -> list[ElementTree.Element]:
    """What shapes may refer to: definitions, clips, gradients, styles."""
    definitions, waiting = [], list(root)
    while waiting:
        element = waiting.pop(0)
        if local_name(element) in NOT_DRAWN:
            definitions.append(element)
        else:
            waiting += list(element)
    return definitions
