"""The drawing that a fit begins with: a file of cubicsplat, or any other SVG as a scene that is near to it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import are_lines, points_at
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.read import read_file
from cubicsplat_cli.formatting import counted, printable
from cubicsplat_cli.raster.strokes import OffsetPlan
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.scene.paint import Gradient, mean_fill
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.painted import LEAST_OPACITY, Paint, PaintedShape, painted_shapes
from cubicsplat_cli.svg.paths import Subpath, groups_apart
from cubicsplat_cli.svg.scene_reader import read_svg
from cubicsplat_cli.svg.untrusted import SvgSize, check_untrusted
from cubicsplat_cli.svg.values import Rgba

ASPECT_TOLERANCE = 0.01  # sides of canvases are whole pixels
_SIDE = 1024  # px, the least longer side of a scene whose shape would change if that was rounded
_PARTS = 2  # most cubics for the offset of each cubic of a stroke
_MOST_POINTS = 2**23  # of all curves, with the room that the longest one needs for each


@record
class InitialDrawing:
    """A scene of any size that a fit begins with. name, sha256: of its file. notes: for users, how it was read."""

    scene: Scene
    name: str
    sha256: str
    notes: tuple[str, ...] = ()

    def check_shape(self, width: int, height: int) -> None:
        """Raise InputError if a picture of width x height px has another shape."""
        scene = self.scene
        if abs(scene.width * height / (scene.height * width) - 1.0) > ASPECT_TOLERANCE:
            text = f"the drawing {self.name} has {scene.width} x {scene.height} px, another shape than the picture's"
            raise InputError(f"{text} {width} x {height}; use an SVG with the picture's proportions")


def load_initial_drawing(source: str | Path | bytes, mode: Mode = Mode.CLOSED) -> InitialDrawing:
    """Return a drawing from its path or bytes.

    mode: of an SVG that cubicsplat did not write: closed for fills, and strokes as the outlines of what they cover;
    open for strokes alone. Gradients become their mean colours. Raises InputError, with the name, for a file that is no
    SVG or shows no shape of that kind.
    """
    data = source if isinstance(source, bytes) else read_file(Path(source))
    name = "the SVG" if isinstance(source, bytes) else printable(str(source))
    try:
        return InitialDrawing(read_svg(data), name, sha256_of(data))
    except InputError:
        return _foreign(data, name, mode)


def _foreign(data: bytes, source: str, mode: Mode) -> InitialDrawing:
    """Return any SVG as a scene without a background, with a note on each thing that it lacks."""
    size = check_untrusted(data, source)
    whole = size.width.is_integer() and size.height.is_integer()
    scale = 1.0 if whole else max(1.0, _SIDE / max(size.width, size.height))
    drawing = painted_shapes(data, source, size, SvgSize(scale * size.width, scale * size.height))
    curves = [curve for shape in drawing.shapes for curve in _curves_of(shape, mode, drawing.left_out)][::-1]
    if not curves:
        kind = "stroke" if mode is Mode.OPEN else "filled shape"
        other = "; --mode closed reads fills" if mode is Mode.OPEN else ""
        raise InputError(f"{source}: shows no {kind} that could be begun with{other}")
    longest = max(sum(len(ring) for ring in curve.rings) for curve in curves)
    if 3 * longest * len(curves) > _MOST_POINTS:
        amounts = f"{counted(len(curves), 'shape')}, one of {longest} segments"
        raise InputError(f"{source}: has {amounts}, too many to begin with; simplify it")
    notes = drawing.notes(" of the drawing to begin with")
    gradients = sum(isinstance(paint, Gradient) for shape in drawing.shapes for paint in (shape.fill, shape.stroke))
    if gradients:
        notes.append(f"begun with the mean colours of {counted(gradients, 'gradient')}")
    points, ring_ends = pack_rings(mode, [[_points(ring, mode) for ring in curve.rings] for curve in curves])
    paints = np.array([curve.paint for curve in curves], np.float32)
    scene = Scene(
        mode, round(drawing.width), round(drawing.height), points, paints[:, :3].copy(), paints[:, 3].copy(),
        np.array([curve.half_width for curve in curves], np.float32), None, ring_ends,
    )  # fmt: skip
    return InitialDrawing(scene, source, sha256_of(data), tuple(f"{source}: {note}" for note in notes))


class _Curve(NamedTuple):
    """rings: the cubics (M, 4, 2) of each ring, or of a stroke, in px."""

    rings: list[np.ndarray]
    paint: Rgba
    half_width: float = 0.0


def _curves_of(shape: PaintedShape, mode: Mode, left_out: Counter[str]) -> Iterator[_Curve]:
    """Yield the curves of a shape's fill, then those of its stroke, which is in front."""
    fill, stroke = (_colour(paint) for paint in (shape.fill, shape.stroke))
    if fill is not None and mode is Mode.OPEN:
        left_out["fill"] += 1
    elif fill is not None:
        rings = [ring for ring in (line.ring() for line in shape.lines) if len(ring) > 2 or _area(ring) != 0.0]
        # A tracer's compound path becomes many curves, because a fit moves each of them.
        for indices in groups_apart(rings):
            group = [rings[index] for index in indices]
            yield _Curve(_oriented(group) if shape.even_odd else group, fill)
    if stroke is None:
        return
    for line in shape.lines:
        if mode is Mode.OPEN:
            yield _Curve([line.ring() if line.closed else line.cubics], stroke, shape.width / 2.0)
        else:
            # The frame skews the strokes as the shape's matrix does, but does not scale them.
            frame = np.diag([*([1.0 / math.sqrt(abs(np.linalg.det(shape.matrix[:2, :2])))] * 2), 1.0]) @ shape.matrix
            around = _around(line.mapped(np.linalg.inv(frame)), shape)
            yield _Curve([Subpath(ring, True).mapped(frame).cubics for ring in around], stroke)


def _around(line: Subpath, shape: PaintedShape) -> list[np.ndarray]:
    """Return the closed cubics (M, 4, 2) around a shape's stroke along a line.

    They are near enough to begin a fit with; the segments that would make them exact would take twice the time.
    """
    cubics = line.ring() if line.closed else line.cubics
    lines = are_lines(cubics)
    plan = OffsetPlan.of(cubics, lines, "closed" if line.closed else shape.cap, shape.join)
    outline = replace(plan, parts=np.minimum(plan.parts, _PARTS)).outline(cubics, shape.width / 2.0)
    return np.split(outline.cubics, outline.ends[:-1])


def _colour(paint: Paint | None) -> Rgba | None:
    """Return the colour and opacity of a paint, the mean of a gradient; None if there is none to be seen."""
    if isinstance(paint, Gradient):
        red, green, blue, alpha = (level / 255.0 for level in mean_fill(paint))
        paint = red, green, blue, alpha
    return None if paint is None or paint[3] < LEAST_OPACITY else paint


def _points(cubics: np.ndarray, mode: Mode) -> np.ndarray:
    """Return the control points (K, 2) of a chain of cubics (M, 4, 2)."""
    points = cubics[:, :3].reshape(-1, 2)
    points = np.concatenate([points, cubics[-1, 3:]]) if mode is Mode.OPEN else points
    return points.astype(np.float32)


def _polygon(ring: np.ndarray) -> np.ndarray:
    """Return points (8 M, 2) along a ring."""
    return points_at(ring, np.arange(8) / 8.0).reshape(-1, 2)


def _area(ring: np.ndarray) -> float:
    x, y = _polygon(ring).T
    return 0.5 * float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def _oriented(rings: list[np.ndarray]) -> list[np.ndarray]:
    """Return rings in directions by which the nonzero rule fills nested rings like the even-odd rule."""
    if len(rings) < 2:
        return rings
    from skimage.measure import points_in_poly  # which few drawings need

    polygons = [_polygon(ring) for ring in rings]
    oriented = []
    for index, ring in enumerate(rings):
        others = polygons[:index] + polygons[index + 1 :]
        depth = sum(bool(points_in_poly(polygons[index][:1], polygon)[0]) for polygon in others)
        outwards = _area(ring) > 0.0
        oriented.append(ring if outwards == (depth % 2 == 0) else ring[::-1, ::-1])
    return oriented
