"""Outlines as DXF, for cutters, engravers and CAD: polylines of lines and circular arcs, a layer for each colour."""

from __future__ import annotations

import io
from collections.abc import Iterator

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import crossed, cubic_parts, points_at
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.formatting import hex_text
from cubicsplat_cli.scene.paint import mean_fill
from cubicsplat_cli.svg.painted import Paint, PaintedShapes

MM_PER_PX = 25.4 / 96.0  # as CSS has it
_VERSION = "R2010"  # the oldest that ezdxf writes as UTF-8, with true colours
_MOST_HALVINGS = 24
_MOST_VERTICES = 500_000  # of one outline and of a file, which take seconds and 250 MB
_AT_ONCE = 10_000  # cubics per batch, which limits the memory
_TOO_MANY = f"needs more than {_MOST_VERTICES} arcs; give a larger --dxf-tolerance"
_SAMPLES = np.arange(1, 16) / 16.0


def dxf(drawing: PaintedShapes, mark: str, tolerance: float) -> bytes:
    """Return the file. tolerance: largest distance of its arcs from the outlines, px. mark: text of its first comment.

    Raises InputError if that takes too many arcs.
    """
    import ezdxf

    document = ezdxf.new(_VERSION, units=ezdxf.units.MM)
    width, height = drawing.width * MM_PER_PX, drawing.height * MM_PER_PX
    document.set_modelspace_vport(height, (width / 2.0, height / 2.0))
    space, count = document.modelspace(), 0
    for colour, vertices, closed, pen in _outlines(drawing, tolerance):
        layer = hex_text(colour)
        if layer not in document.layers:
            document.layers.add(layer, true_color=ezdxf.colors.rgb2int(colour))
        outline = space.add_lwpolyline(vertices, format="xyb", close=closed, dxfattribs={"layer": layer})
        if pen:
            outline.dxf.const_width = pen
        count += len(vertices)
        if count > _MOST_VERTICES:
            raise InputError(_TOO_MANY)
    stream = io.StringIO()
    document.write(stream)
    return f"999\n{mark}\n{stream.getvalue()}".encode(document.output_encoding, "dxfreplace")


def _outlines(
    drawing: PaintedShapes, tolerance: float
) -> Iterator[tuple[tuple[int, int, int], np.ndarray, bool, float]]:
    """Yield each subpath's colour, vertices in mm with y up, whether it is closed, and its width in mm, 0 if filled."""
    to_mm = np.array([[MM_PER_PX, 0.0, 0.0], [0.0, -MM_PER_PX, drawing.height * MM_PER_PX], [0.0, 0.0, 1.0]])
    for shape in drawing.shapes:
        for paint, pen in ((shape.fill, 0.0), (shape.stroke, shape.width * MM_PER_PX)):
            if paint is None:
                continue
            for line in (line.mapped(to_mm) for line in shape.lines):
                closed = line.closed or not pen
                vertices = arcs_along(line.ring() if closed else line.cubics, tolerance * MM_PER_PX)
                if not closed:
                    vertices = np.vstack([vertices, [*line.cubics[-1, 3], 0.0]])
                yield _colour(paint), vertices, closed, pen


def _colour(paint: Paint) -> tuple[int, int, int]:
    red, green, blue = [round(255.0 * part) for part in paint[:3]] if isinstance(paint, tuple) else mean_fill(paint)[:3]
    return red, green, blue


def arcs_along(cubics: np.ndarray, tolerance: float, most: int = _MOST_VERTICES) -> np.ndarray:
    """Return circular arcs (k, 3) along cubics (n, 4, 2) as in DXF: the start of each, and its bulge.

    The bulge is the tangent of a quarter of its angle, positive if counterclockwise where y points up, 0 for a line.
    Each cubic is halved until its two tangent arcs are within the tolerance of it, in its own units. Raises InputError
    if that takes more than `most`.
    """
    order, size, done = np.arange(len(cubics), dtype=float), 1.0, []
    for halving in range(_MOST_HALVINGS + 1):
        parts = [_biarcs(cubics[first : first + _AT_ONCE]) for first in range(0, len(cubics), _AT_ONCE)]
        joints, bulges, errors = (np.concatenate(part) for part in zip(*parts, strict=True))
        # A cubic that is smaller than the tolerance becomes a line.
        reach = np.abs(cubics - cubics[:, :1]).max(axis=(1, 2))
        tiny = (reach <= tolerance / 2.0) | (halving == _MOST_HALVINGS)
        bulges[tiny] = 0.0
        fits, bent = tiny | (errors <= tolerance), np.abs(bulges).max(axis=1) > 1e-9
        done.append(np.column_stack([order, cubics[:, 0], bulges[:, 0]])[fits])
        done.append(np.column_stack([order + size / 2.0, joints, bulges[:, 1]])[fits & bent])
        halves = np.stack(cubic_parts(cubics[~fits].transpose(1, 0, 2), 0.5)).transpose(2, 0, 1, 3)
        cubics, size = halves.reshape(-1, 4, 2), size / 2.0
        if len(cubics) > most:
            raise InputError(_TOO_MANY)
        order = (order[~fits, None] + [0.0, size]).ravel()
        if not len(cubics):
            break
    vertices = np.concatenate(done)
    return vertices[np.argsort(vertices[:, 0], kind="stable"), 1:]


def _biarcs(cubics: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the joint (n, 2) of two arcs for each cubic, their bulges (n, 2), and their error (n,).

    The arcs have the tangents of the cubic at its ends, meet smoothly, and have tangents of equal length. The error is
    the largest distance of a sample of the cubic from them, infinite if there are no such arcs.
    """
    start, end = cubics[:, 0], cubics[:, 3]
    first, last = _direction(cubics), -_direction(cubics[:, ::-1])
    chord = end - start
    along = (chord * (first + last)).sum(axis=1)
    square, turn = (chord**2).sum(axis=1), 1.0 - (first * last).sum(axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        reach = (square / (along + np.sqrt(along**2 + 2.0 * turn * square)))[:, None]
        corners = np.stack([start + reach * first, end - reach * last], axis=1)
        joints = corners.mean(axis=1)
        bulges = np.stack([_half_tangent(first, joints - start), _half_tangent(end - joints, last)], axis=1)
        samples = points_at(cubics, _SAMPLES)
        beyond = ((samples - joints[:, None]) * (corners[:, 1] - corners[:, 0])[:, None]).sum(axis=2) > 0.0
        errors = np.where(
            beyond, _distances(samples, joints, end, bulges[:, 1]), _distances(samples, start, joints, bulges[:, 0])
        ).max(axis=1)
    sound = np.isfinite(errors) & (reach[:, 0] > 0.0) & (np.abs(bulges) <= 1.0).all(axis=1)
    return joints, bulges, np.where(sound, errors, np.inf)


def _direction(cubics: np.ndarray) -> np.ndarray:
    """Return the unit vectors (n, 2) of cubics at their start, towards the first other control point."""
    steps = cubics[:, 1:] - cubics[:, :1]
    lengths = np.hypot(steps[..., 0], steps[..., 1])
    chosen = np.argmax(lengths > 1e-6 * np.maximum(lengths.max(axis=1), 1e-300)[:, None], axis=1)
    rows = np.arange(len(cubics))
    return steps[rows, chosen] / np.maximum(lengths[rows, chosen], 1e-300)[:, None]


def _half_tangent(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the tangent of half the angle between vectors (n, 2), counterclockwise where y points up."""
    return np.tan(np.arctan2(crossed(first, second), (first * second).sum(axis=1)) / 2.0)


def _distances(points: np.ndarray, start: np.ndarray, end: np.ndarray, bulge: np.ndarray) -> np.ndarray:
    """Return the distances (n, s) of points (n, s, 2) from the circles of arcs, to first order.

    An arc with the bulge 0 is a line. With u along the chord of length L from its middle, w to its left and bulge b,
    the circle is b (u^2 + w^2 - L^2 / 4) + w L (b^2 - 1) / 2 = 0.
    """
    chord = end - start
    size = np.hypot(chord[:, 0], chord[:, 1])
    x, y = (chord / size[:, None]).T[..., None]
    offset = points - ((start + end) / 2.0)[:, None]
    u, w = x * offset[..., 0] + y * offset[..., 1], x * offset[..., 1] - y * offset[..., 0]
    b, size = bulge[:, None], size[:, None]
    tilt = size * (b**2 - 1.0) / 2.0
    value = b * (u**2 + w**2 - size**2 / 4.0) + w * tilt
    return np.abs(value) / np.hypot(2.0 * b * u, 2.0 * b * w + tilt)
