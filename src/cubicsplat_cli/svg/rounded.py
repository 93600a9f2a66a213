"""Rectangles with round corners as path data of lines and quarter circles, and read back from it.

cairosvg, and whatever is made of it, bends two corners of `<rect rx>` wrongly: the second handle of its cubic is as far
from the corner of the box as it should be from its end, which is 0.036 of the radius off. Arcs all viewers draw alike.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cubicsplat_cli.artwork.geometry.outlines import Rectangle
from cubicsplat_cli.artwork.geometry.steps import to_steps
from cubicsplat_cli.svg.drawing_paths import PathText
from cubicsplat_cli.svg.paths import PathSegment, Point

# Letters of the kinds: round at the left and right ends, at upper and lower ones, at all corners in either direction.
LETTERS = ("HAHAZ", "VAVAZ", "HAVAHAVAZ", "VAHAVAHAZ")
MOST_ON_RECT = 3.0  # px, the radius up to which viewers agree about `<rect rx>` to a tenth of a px


def add_rounded(path: PathText, box: Rectangle, precision: int, *, clockwise: bool) -> None:
    """Appends a level rectangle with round corners; nothing where it has no extent."""
    left, top, right, bottom, radius = _steps(box, precision)
    if radius <= 0:
        return
    ends = [(int(x), int(y)) for x, y in _ends(left, top, right, bottom, radius)]
    if not clockwise:
        ends.reverse()
    path.move(ends[0])
    # Lines and arcs in turn; closing the path would draw the last arc as a line.
    for k, end in enumerate([*ends[1:], ends[0]]):
        if k % 2:
            path.arc((radius, radius), "0", (0, int(clockwise)), end)
        else:
            path.line(end)
    path.close()


def rounded_of(subpath: Sequence[PathSegment]) -> tuple[Rectangle, bool] | None:
    """The rectangle that `add_rounded` wrote as these pieces, and whether clockwise as seen; None for other pieces."""
    if "".join(piece.command for piece in subpath) not in LETTERS:
        return None
    arcs = [piece for piece in subpath if piece.command == "A"]
    radius, sweep = arcs[0].numbers[0], arcs[0].numbers[4]
    numbers = (radius, radius, 0.0, 0.0, sweep)
    starts = [piece.start for piece in subpath[:-1]]
    x, y = zip(*starts, strict=True)
    across, down = (radius if len(arcs) == 2 and subpath[0].command == letter else 0.0 for letter in "HV")
    left, right, top, bottom = min(x) - across, max(x) + across, min(y) - down, max(y) + down
    expected = list(_ends(left, top, right, bottom, radius))
    expected = expected if sweep == 1.0 else expected[::-1]
    off = max(max(abs(a[0] - b[0]), abs(a[1] - b[1])) for a, b in zip(starts, expected, strict=True))
    if any(arc.numbers != numbers for arc in arcs) or radius <= 0.0 or off > 1e-6 or subpath[-1].start != starts[0]:
        return None
    return Rectangle(left, top, right - left, bottom - top, radius), sweep == 1.0


def _steps(box: Rectangle, precision: int) -> tuple[int, int, int, int, int]:
    """Left, top, right, bottom and radius in steps, the radius at most half of the shorter side."""
    left, right, top, bottom = (
        int(to_steps(v, precision)) for v in (box.x, box.x + box.width, box.y, box.y + box.height)
    )
    radius = min(int(to_steps(box.radius, precision)), (right - left) // 2, (bottom - top) // 2)
    return left, top, right, bottom, radius


def _ends(left: float, top: float, right: float, bottom: float, radius: float) -> Iterator[Point]:
    """The points where lines and arcs meet, clockwise as seen, a line first; sides shorter than a point are left out,
    and the corners beside them are one arc.
    """
    across, down = right - left > 2 * radius + 1e-9, bottom - top > 2 * radius + 1e-9
    if across:
        yield left + radius, top
        yield right - radius, top
    if down:
        yield right, top + radius
        yield right, bottom - radius
    if across:
        yield right - radius, bottom
        yield left + radius, bottom
    if down:
        yield left, bottom - radius
        yield left, top + radius
