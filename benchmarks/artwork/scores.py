"""The scores of one drawing by one tool: sizes and differences, against the truth."""

from __future__ import annotations

import copy
import gzip
import re
import time
from dataclasses import asdict, dataclass
from typing import Any
from xml.etree import ElementTree

from benchmarks.artwork.degradations import CLEAN, DEGRADATIONS, with_background
from benchmarks.artwork.document import PRIMITIVES, Document
from benchmarks.artwork.pieces import completed, pieces_of, visible_error
from benchmarks.artwork.pixels import edge_displacement, exact_colours, leak_areas, opaque_inside, psnr
from benchmarks.artwork.primitives import primitive_counts
from benchmarks.tools import Given, Tool
from cubicsplat_cli.evaluate.perceptual import mean_delta_e
from cubicsplat_cli.svg.elements import XLINK_HREF, local_name
from cubicsplat_cli.svg.paths import commands
from cubicsplat_cli.svg.values import NUMBERS

_REFERENCE = re.compile(r"#([^\s'\")]+)")
_INVISIBLE = {"title", "desc", "metadata"}


@dataclass(frozen=True)
class Counts:
    """shapes: elements that are drawn, those of a `use` each time. coordinates: numbers as written: of path data and
    points (an arc has 5), 3 of a circle, 4 of an ellipse, line or rect (5 with round corners), 2 of a `use`.
    primitives: circles, ellipses, rects and lines among the shapes. gzipped_bytes: of `minified`.
    """

    shapes: int
    coordinates: int
    primitives: int
    gzipped_bytes: int


def count(document: Document) -> Counts:
    """Counts of a document; InputError where its path data cannot be read."""
    names = [shape.name for shape in document.shapes()]
    return Counts(
        shapes=len(names),
        coordinates=sum(_coordinates(element) for element in document.root.iter()),
        primitives=sum(name in PRIMITIVES for name in names),
        gzipped_bytes=len(gzip.compress(minified(document.root), 9, mtime=0)),
    )


def minified(root: ElementTree.Element) -> bytes:
    """The document without comments, titles, descriptions, metadata, the space between elements, the ids that nothing
    refers to, and attributes of other namespaces. Numbers and paths stay as they are.
    """
    root = copy.deepcopy(root)
    text = ElementTree.tostring(root, encoding="unicode")
    referenced = set(_REFERENCE.findall(text))
    for element in root.iter():
        for child in list(element):
            if local_name(child) in (*_INVISIBLE, ""):
                element.remove(child)
        if element.get("id") not in referenced:
            element.attrib.pop("id", None)
        for name in [name for name in element.attrib if name.startswith("{") and name != XLINK_HREF]:
            del element.attrib[name]
        if local_name(element) != "style":
            element.text = None
        element.tail = None
    return ElementTree.tostring(root).replace(b" />", b"/>")


def count_numbers(d: str) -> int:
    """Numbers in path data, but for the two flags of an arc."""
    return sum(len(numbers) - 2 * (letter in "Aa") for letter, numbers in commands(d))


def _coordinates(element: ElementTree.Element) -> int:
    name = local_name(element)
    if name == "path":
        return count_numbers(element.get("d", ""))
    if name in ("polygon", "polyline"):
        return len(NUMBERS.findall(element.get("points", "")))
    if name == "use":
        return 2
    return PRIMITIVES.get(name, 0) + (name == "rect" and (element.get("rx") or element.get("ry")) is not None)


@dataclass(frozen=True)
class Scores:
    """One SVG against the truth. delta_e: mean CIEDE2000 at twice the size. psnr_1x_db, psnr_4x_db: at the input's
    size and four times it. The ratios are to the artist's own file. seconds: wall clock; cpu_seconds: of all threads.
    leak_*: px of the background that leak through, at 1, 4 and 16 times the size. edge_px: mean displacement of the
    edges. exact_colours: share of the truth's fill colours that are exact. primitive_recall, primitive_precision:
    shares of the truth's and of the file's primitives. completed: share of the truth's partly hidden pieces that the
    file has whole; visible_error: mean share of a removed piece's place that then shows a wrong colour. The last four
    are None without any such element, or with too many.
    """

    picture: str
    tool: str
    delta_e: float
    psnr_1x_db: float
    psnr_4x_db: float
    shapes_ratio: float
    coordinates_ratio: float
    bytes_ratio: float
    seconds: float
    cpu_seconds: float
    leak_1x_px: float
    leak_4x_px: float
    leak_16x_px: float
    edge_px: float | None
    exact_colours: float | None
    primitive_recall: float | None
    primitive_precision: float | None
    completed: float | None
    visible_error: float | None
    shapes: int
    coordinates: int
    primitives: int
    gzipped_bytes: int
    artist_shapes: int
    artist_coordinates: int
    artist_primitives: int
    artist_gzipped_bytes: int


class Truth:
    """A drawing as its artist made it, its pictures, and the input of the tools."""

    def __init__(self, data: bytes, name: str, size: int, kind: str = CLEAN) -> None:
        """size: px of the longer side of the input; kind: a name in DEGRADATIONS. Raises InputError for a file that
        cannot be drawn or counted.
        """
        self.name = name
        self.document = Document(data, name, size)
        self.counts = count(self.document)
        with_background(self.document, kind)
        self.input: Given = DEGRADATIONS[kind](self.document)
        self.drawn = {scale: self.document.draw(scale) for scale in (1, 2, 4)}
        self.opaque = opaque_inside(self.document)
        self.pieces = pieces_of(self.document)


@dataclass(frozen=True, eq=False)
class ToolResult:
    """The SVG of a tool, and the seconds it took: wall clock, and of the processor, all threads together."""

    svg: bytes
    seconds: float
    cpu_seconds: float


def run_tool(tool: Tool, truth: Truth) -> ToolResult:
    """Vectorize the input of `truth`; raises whatever the tool raises."""
    wall, cpu = time.perf_counter(), time.process_time()
    svg = tool(truth.input)
    return ToolResult(svg, time.perf_counter() - wall, time.process_time() - cpu)


def measure(truth: Truth, name: str, made: ToolResult) -> Scores:
    """The scores of the SVG that the tool `name` made; InputError where it cannot be drawn or counted."""
    document = Document(made.svg, f"{truth.name} by {name}", max(truth.document.width, truth.document.height))
    drawn = {scale: document.draw(scale) for scale in (1, 2, 4)}
    counts, artist = count(document), truth.counts
    leaks = leak_areas(document, truth.opaque, drawn)
    return Scores(
        picture=truth.name,
        tool=name,
        delta_e=mean_delta_e(truth.drawn[2], drawn[2]),
        psnr_1x_db=psnr(truth.drawn[1], drawn[1]),
        psnr_4x_db=psnr(truth.drawn[4], drawn[4]),
        shapes_ratio=counts.shapes / max(1, artist.shapes),
        coordinates_ratio=counts.coordinates / max(1, artist.coordinates),
        bytes_ratio=counts.gzipped_bytes / artist.gzipped_bytes,
        seconds=made.seconds,
        cpu_seconds=made.cpu_seconds,
        leak_1x_px=leaks[0],
        leak_4x_px=leaks[1],
        leak_16x_px=leaks[2],
        edge_px=edge_displacement(truth.drawn[2], drawn[2], 2),
        exact_colours=exact_colours(truth.drawn[2], drawn[2]),
        **_structure(truth, document),
        **asdict(counts),
        **{f"artist_{member}": value for member, value in asdict(artist).items()},
    )


def _structure(truth: Truth, document: Document) -> dict[str, Any]:
    """Recall and precision of primitives, share of completed pieces, visible error."""
    pieces = pieces_of(document)
    if truth.pieces is None or pieces is None:
        return dict.fromkeys(("primitive_recall", "primitive_precision", "completed", "visible_error"))
    recalled, expected, right, written = primitive_counts(truth.document, truth.pieces, document, pieces)
    return {
        "primitive_recall": _share(recalled, expected),
        "primitive_precision": _share(right, written),
        "completed": _share(*completed(truth.pieces, pieces)),
        "visible_error": visible_error(truth.pieces, pieces),
    }


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
