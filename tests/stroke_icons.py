"""Icons drawn with pens, as their SVG says it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.artwork.geometry.outlines import points_at
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.svg.paths import subpaths

SIZE, FINE = 256, 8


@dataclass(frozen=True)
class Pen:
    """A path drawn with a pen of a width in px."""

    d: str
    width: float
    cap: str = "butt"
    join: str = "miter"


def _spiral() -> str:
    """Three turns, of cubics of an eighth of a turn each."""

    def place(a: float) -> tuple[float, float]:
        return 128 + (8 + 4.6 * a) * math.cos(a), 128 + (8 + 4.6 * a) * math.sin(a)

    def way(a: float) -> tuple[float, float]:
        return (
            4.6 * math.cos(a) - (8 + 4.6 * a) * math.sin(a),
            4.6 * math.sin(a) + (8 + 4.6 * a) * math.cos(a),
        )

    step = math.pi / 4
    d = "M{:.3f} {:.3f}".format(*place(0.0))
    for i in range(24):
        (x0, y0), (x1, y1) = place(i * step), place((i + 1) * step)
        (u0, v0), (u1, v1) = way(i * step), way((i + 1) * step)
        numbers = (x0 + u0 * step / 3, y0 + v0 * step / 3, x1 - u1 * step / 3, y1 - v1 * step / 3, x1, y1)
        d += "C" + " ".join(f"{number:.3f}" for number in numbers)
    return d


def _gear() -> str:
    corners = []
    for k in range(8):
        for radius, turn in ((70, -0.25), (95, -0.17), (95, 0.17), (70, 0.25)):
            a = k * math.pi / 4 + turn
            corners.append(f"{128 + radius * math.cos(a):.2f} {128 + radius * math.sin(a):.2f}")
    return "M" + "L".join(corners) + "z"


def _circle(radius: float) -> str:
    """Four cubics, true to 3e-4 of the radius."""
    r, k = radius, radius * 0.5522847
    return (
        f"M{128 + r} 128C{128 + r} {128 + k} {128 + k} {128 + r} 128 {128 + r}"
        f"S{128 - r} {128 + k} {128 - r} 128 {128 - k} {128 - r} 128 {128 - r}S{128 + r} {128 - k} {128 + r} 128z"
    )


ICONS: dict[str, list[Pen]] = {
    "circle": [Pen(_circle(88), 10)],
    "checkmark": [Pen("M50 130L105 190L210 70", 14, "round", "round")],
    "checkmark with sharp ends": [Pen("M50 130L105 190L210 70", 14)],
    "cross": [Pen("M60 60L196 196", 12, "round"), Pen("M196 60L60 196", 12, "round")],
    "spiral": [Pen(_spiral(), 5, "round")],
    "letter s": [Pen("M185 80C170 40 80 35 75 85C72 130 190 120 190 175C188 225 85 220 68 180", 18, "round")],
    "grid": [
        *(Pen(f"M{x} 40V216", 4) for x in (60, 100, 140, 180)),
        *(Pen(f"M40 {y}H216", 4) for y in (60, 105, 150, 195)),
    ],
    "gear": [Pen(_gear(), 8, "butt", "round"), Pen(_circle(30), 8)],
    "waves": [
        Pen(f"M20 {y}C60 {y - 60} 90 {y + 60} 128 {y}S200 {y - 50} 236 {y}", width, "round")
        for y, width in ((60, 2), (128, 6), (196, 20))
    ],
    "arrow": [Pen("M40 128H210", 10), Pen("M150 68L210 128L150 188", 10)],
    "round arrow": [Pen("M40 128H210", 10, "round"), Pen("M150 68L210 128L150 188", 10, "round", "round")],
    "triangle": [Pen("M128 50L210 190H46z", 9)],
    "house": [
        Pen("M40 130L128 50L216 130", 10, "round", "round"),
        Pen("M65 115V205H191V115", 10, "round", "round"),
        Pen("M108 205V150H148V205", 6),
    ],
    "clock": [Pen(_circle(90), 8), Pen("M128 80V128L165 150", 8, "round", "round")],
    "infinity": [Pen("M128 128C100 90 40 90 40 128S100 166 128 128S216 90 216 128S156 166 128 128z", 11)],
    "thin cross": [Pen("M50 40L200 210", 3), Pen("M205 45L45 200", 3)],
}


def svg_of(pens: list[Pen]) -> str:
    """The icon in dark blue on white."""
    paths = "".join(
        f'<path d="{pen.d}" fill="none" stroke="#1a2b6d" stroke-width="{pen.width}" '
        f'stroke-linecap="{pen.cap}" stroke-linejoin="{pen.join}"/>'
        for pen in pens
    )
    ground = f'<rect width="{SIZE}" height="{SIZE}" fill="#fff"/>'
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{SIZE}" height="{SIZE}" viewBox="0 0 {SIZE} {SIZE}">'
        f"{ground}{paths}</svg>"
    )


def picture_of(pens: list[Pen]) -> np.ndarray:
    """(SIZE, SIZE, 3) uint8: drawn FINE times as large by an independent renderer, and averaged."""
    drawn = rerender(svg_of(pens).encode(), SIZE * FINE, SIZE * FINE).pixels[..., :3].astype(float)
    return np.rint(drawn.reshape(SIZE, FINE, SIZE, FINE, 3).mean(axis=(1, 3))).astype(np.uint8)


def sampled_picture_of(pens: list[Pen]) -> np.ndarray:
    """(SIZE, SIZE, 3) uint8: drawn at its own size by an independent renderer, with its few samples a pixel."""
    return rerender(svg_of(pens).encode(), SIZE, SIZE).pixels[..., :3]


def line_of(pen: Pen) -> np.ndarray:
    """(n, 2) px, points about a fiftieth of a px apart along a pen's way."""
    found = []
    for ring in subpaths(pen.d):
        for piece in ring:
            start, end = np.array(piece.start), np.array(piece.end)
            handles = piece.handles or (start + (end - start) / 3.0, end - (end - start) / 3.0)
            cubic = np.stack([start, *map(np.array, handles), end])
            length = float(np.hypot(*np.diff(cubic, axis=0).T).sum())
            found.append(points_at(cubic[None], np.linspace(0.0, 1.0, max(2, int(50 * length)))[None])[0])
    return np.concatenate(found)
