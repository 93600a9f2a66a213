"""The drawing that a fit begins with: one of ours, or any other SVG as near as it comes to a scene."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import points_at
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.read import read_file
from cubicsplat_cli.formatting import counted, one_line, printable
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.elements import LEAST_OPACITY, StyledShape, StyledTree, local_name, reference
from cubicsplat_cli.svg.paths import MAX_COMMANDS, Subpath, TooLong, apart, cubic_subpaths
from cubicsplat_cli.svg.scene_reader import read_svg
from cubicsplat_cli.svg.stroke_outlines import stroke_rings
from cubicsplat_cli.svg.untrusted import check_untrusted
from cubicsplat_cli.svg.values import Rgba, colour, parse_length, share

ASPECT_TOLERANCE = 0.01  # sides of canvases are whole pixels
_SIDE = 1024  # px of the scene's longer side at the least, where rounding that would change its shape
_MOST_POINTS = 2**23  # of all curves, each with as much room as the longest one needs


@dataclass(frozen=True, eq=False)
class InitialDrawing:
    """A scene to begin a fit with, of any size; name and sha256: of the file that it is from. notes: what the user
    should know about how it was read, a sentence each.
    """

    scene: Scene
    name: str
    sha256: str
    notes: tuple[str, ...] = ()

    def check_shape(self, width: int, height: int) -> None:
        """Raise InputError where a picture of width x height px has another shape."""
        scene = self.scene
        if abs(scene.width * height / (scene.height * width) - 1.0) > ASPECT_TOLERANCE:
            raise InputError(
                f"the drawing {self.name} has {scene.width} x {scene.height} px, another shape than the picture's "
                f"{width} x {height}; use an SVG with the picture's proportions"
            )


def load_initial_drawing(source: str | Path | bytes, mode: Mode = Mode.CLOSED) -> InitialDrawing:
    """A drawing, from its path or bytes: as cubicsplat wrote it, or as near as any other SVG comes to a scene.

    mode: what to read of an SVG of others. Raises InputError, with its name, for what is no SVG or shows no shape.
    """
    data = source if isinstance(source, bytes) else read_file(Path(source))
    name = "the SVG" if isinstance(source, bytes) else printable(str(source))
    try:
        return InitialDrawing(read_svg(data), name, sha256_of(data))
    except InputError:
        scene, notes = read_foreign(data, name, mode)
        return InitialDrawing(scene, name, sha256_of(data), tuple(notes))


def read_foreign(data: bytes, source: str, mode: Mode = Mode.CLOSED) -> tuple[Scene, list[str]]:
    """The scene of an SVG, without a background, and what of the file is not in it, a sentence each.

    Closed: fills, and strokes as the outlines of what they cover; open: strokes alone. Paths, basic shapes, groups,
    uses, transforms, `style=` and simple style sheets are read; gradients count by their mean colour. Raises
    InputError, with the source, for what is no SVG, or shows no shape of that kind.
    """
    size = check_untrusted(data, source)
    try:
        root = ElementTree.fromstring(data)
    except ElementTree.ParseError as error:  # what expat alone does not mind, an unknown prefix say
        raise InputError(f"{source}: is not well-formed XML ({error}); export it again") from error
    whole = size.width.is_integer() and size.height.is_integer()
    scale = 1.0 if whole else max(1.0, _SIDE / max(size.width, size.height))
    collected = _Collected(mode)
    try:
        tree = StyledTree(root, collected.left_out)
        for shape in tree.shapes(size.width, size.height):
            collected.add(tree, shape, scale)
    except (InputError, ValueError) as error:
        raise InputError(f"{source}: {one_line(error)}") from error
    if not collected.curves:
        kind = "stroke" if mode is Mode.OPEN else "filled shape"
        other = "; --mode closed reads fills" if mode is Mode.OPEN else ""
        raise InputError(f"{source}: shows no {kind} that could be begun with{other}")
    longest = max(sum(len(ring) for ring in rings) for rings in collected.curves)
    if 3 * longest * len(collected.curves) > _MOST_POINTS:
        raise InputError(
            f"{source}: has {counted(len(collected.curves), 'shape')}, one of {longest} segments, too many to begin "
            "with; simplify it"
        )
    return collected.scene(round(size.width * scale), round(size.height * scale)), collected.notes(source)


@dataclass
class _Collected:
    """Curves with their paints, the first at the back. curves: the cubics (M, 4, 2) of each ring, or of a stroke, in
    px; left_out: see `StyledTree`.
    """

    mode: Mode
    left_out: Counter[str] = field(default_factory=Counter)
    gradients: int = 0
    segments: int = 0
    curves: list[list[np.ndarray]] = field(default_factory=list)
    paints: list[Rgba] = field(default_factory=list)
    half_widths: list[float] = field(default_factory=list)

    def add(self, tree: StyledTree, shape: StyledShape, scale: float) -> None:
        """Add the fill of a shape, enlarged by `scale`, and in front of it its stroke."""
        try:
            lines = cubic_subpaths(shape.path_data())
            self.segments += sum(len(line.cubics) for line in lines)
            fill, stroke = (self._paint(tree, shape, name) for name in ("fill", "stroke"))
            width = parse_length(shape.style["stroke-width"], shape.view[0])
        except TooLong:
            raise
        except (InputError, ValueError):
            self.left_out[f"{shape.name} that cannot be read"] += 1
            return
        if self.segments > MAX_COMMANDS:
            raise TooLong(f"path data of more than {MAX_COMMANDS} commands in all, too many to begin with; simplify it")
        matrix = np.diag([scale, scale, 1.0]) @ shape.matrix
        if not np.isfinite(matrix).all() or abs(np.linalg.det(matrix[:2, :2])) < 1e-12:
            return
        if fill is not None and shape.name != "line":
            if self.mode is Mode.OPEN:
                self.left_out["fill"] += 1
            else:
                self._add_fill([line.mapped(matrix) for line in lines], shape.style["fill-rule"] == "evenodd", fill)
        if stroke is not None and width > 0.0:
            self.left_out["dash pattern"] += shape.style["stroke-dasharray"] not in ("none", "")
            self._add_stroke(lines, shape.style, width / 2.0, matrix, stroke)

    def _add_fill(self, lines: list[Subpath], even_odd: bool, paint: Rgba) -> None:
        rings = [ring for ring in (line.ring() for line in lines) if len(ring) > 2 or _area(ring) != 0.0]
        # A tracer's compound path is many curves, and a fit moves each.
        for group in apart(rings):
            self._keep(_oriented(group) if even_odd else group, paint, 0.0)

    def _add_stroke(
        self, lines: list[Subpath], style: Mapping[str, str], half: float, matrix: np.ndarray, paint: Rgba
    ) -> None:
        for line in lines:
            if self.mode is Mode.OPEN:
                mapped = line.mapped(matrix)
                cubics = mapped.ring() if line.closed else mapped.cubics
                self._keep([cubics], paint, half * math.sqrt(abs(np.linalg.det(matrix[:2, :2]))))
            else:
                limit = parse_length(style["stroke-miterlimit"], 1.0)
                around = stroke_rings(line, half, style["stroke-linecap"], style["stroke-linejoin"], limit)
                self._keep([Subpath(ring, True).mapped(matrix).cubics for ring in around], paint, 0.0)

    def _keep(self, rings: list[np.ndarray], paint: Rgba, half_width: float) -> None:
        self.curves.append(rings)
        self.paints.append(paint)
        self.half_widths.append(half_width)

    def _paint(self, tree: StyledTree, shape: StyledShape, name: str) -> Rgba | None:
        """Colour and opacity of a fill or stroke, None where there is none to be seen."""
        paint, opacity = shape.paint(name, lambda identifier: self._mean_of(tree, identifier, shape.style["color"]))
        if paint is None:
            return None
        opacity *= paint[3]
        return None if opacity < LEAST_OPACITY else (*paint[:3], opacity)

    def _mean_of(self, tree: StyledTree, identifier: str, current: str) -> Rgba | None:
        """The mean of a gradient's stops, which it may inherit; None where it is none, or has none."""
        stops: list[ElementTree.Element] = []
        for _ in range(8):
            element = tree.named.get(identifier)
            if stops or element is None or local_name(element) not in ("linearGradient", "radialGradient"):
                break
            stops = [child for child in element if local_name(child) == "stop"]
            identifier = reference(element)
        if not stops:
            self.left_out["pattern"] += 1
            return None
        colours = []
        for stop in stops:
            values = tree.declared(stop)
            rgba = colour(values.get("stop-color", "black"), current) or (0.0, 0.0, 0.0, 0.0)
            colours.append((*rgba[:3], rgba[3] * share(values.get("stop-opacity", "1"))))
        self.gradients += 1
        red, green, blue, opacity = np.mean(colours, axis=0).tolist()
        return red, green, blue, opacity

    def scene(self, width: int, height: int) -> Scene:
        """The curves on a canvas, the last one at the front."""
        shared = [_points(rings, self.mode) for rings in reversed(self.curves)]
        points, ring_ends = pack_rings(self.mode, shared)
        paints = np.array(self.paints[::-1], np.float32)
        return Scene(
            self.mode, width, height, points, paints[:, :3].copy(), paints[:, 3].copy(),
            np.array(self.half_widths[::-1], np.float32), None, ring_ends,
        )  # fmt: skip

    def notes(self, source: str) -> list[str]:
        """A sentence on what the scene lacks, and one on what it approximates."""
        parts = [counted(count, name) for name, count in sorted(self.left_out.items()) if count]
        notes = [f"{source}: left out of the drawing to begin with: {', '.join(parts)}"] if parts else []
        if self.gradients:
            notes.append(f"{source}: begun with the mean colours of {counted(self.gradients, 'gradient')}")
        return notes


def _points(rings: list[np.ndarray], mode: Mode) -> list[np.ndarray]:
    points_of_rings = []
    for cubics in rings:
        points = cubics[:, :3].reshape(-1, 2)
        if mode is Mode.OPEN:
            points = np.concatenate([points, cubics[-1, 3:]])
        points_of_rings.append(points.astype(np.float32))
    return points_of_rings


def _polygon(ring: np.ndarray) -> np.ndarray:
    """(8 M, 2) points along a ring."""
    return points_at(ring, np.arange(8) / 8.0).reshape(-1, 2)


def _area(ring: np.ndarray) -> float:
    x, y = _polygon(ring).T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def _oriented(rings: list[np.ndarray]) -> list[np.ndarray]:
    """Rings turned so that the nonzero rule fills what the even-odd rule does, where they lie in one another."""
    if len(rings) < 2:
        return rings
    polygons = [_polygon(ring) for ring in rings]
    oriented = []
    for index, ring in enumerate(rings):
        depth = sum(_holds(polygon, polygons[index][0]) for other, polygon in enumerate(polygons) if other != index)
        outwards = _area(ring) > 0.0
        oriented.append(ring if outwards == (depth % 2 == 0) else ring[::-1, ::-1])
    return oriented


def _holds(polygon: np.ndarray, point: np.ndarray) -> bool:
    x, y = polygon.T
    across, down = np.roll(x, -1), np.roll(y, -1)
    spans = (y > point[1]) != (down > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossing = x + (point[1] - y) * (across - x) / (down - y)
    return bool((spans & (crossing > point[0])).sum() % 2)
