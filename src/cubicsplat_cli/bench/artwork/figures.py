"""One drawing by one tool: what came out, and how it compares with the truth."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from cubicsplat_cli.bench.artwork.counts import Counts, count
from cubicsplat_cli.bench.artwork.document import Document
from cubicsplat_cli.bench.artwork.edges import edge_displacement
from cubicsplat_cli.bench.artwork.inks import exact_inks
from cubicsplat_cli.bench.artwork.inputs import CLEAN, input_of, with_ground
from cubicsplat_cli.bench.artwork.pieces import Pieces, exposed, pieces_of, restored
from cubicsplat_cli.bench.artwork.primitives import primitive_counts
from cubicsplat_cli.bench.artwork.seams import Opaque, opaque_inside, seam_areas
from cubicsplat_cli.bench.tools import Tool
from cubicsplat_cli.evaluate.colour import mean_delta_e, psnr


@dataclass(frozen=True)
class Figures:
    """Of one SVG against the truth. delta_e: mean CIEDE2000 at twice the size. psnr_1x_db, psnr_4x_db: at the input's
    size and four times it. The ratios are to the artist's own file. seconds: wall clock; cpu_seconds: of all threads.
    seam_*: px of the ground that shows, at 1, 4 and 16 times the size. edge_px: mean displacement of the edges.
    exact_inks: share of the truth's inks. primitive_recall, primitive_precision: shares of the truth's and of the
    file's primitives. restored: share of the truth's covered pieces that are whole; exposed: of the places of pieces
    taken away that then show something wrong. The last four are None without any, or for too many elements.
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
    seam_1x_px: float
    seam_4x_px: float
    seam_16x_px: float
    edge_px: float | None
    exact_inks: float | None
    primitive_recall: float | None
    primitive_precision: float | None
    restored: float | None
    exposed: float | None
    shapes: int
    coordinates: int
    primitives: int
    gzipped_bytes: int
    artist_shapes: int
    artist_coordinates: int
    artist_primitives: int
    artist_gzipped_bytes: int


class Truth:
    """A drawing as its artist made it, its pictures, and what tools get of it."""

    def __init__(self, data: bytes, name: str, size: int, kind: str = CLEAN) -> None:
        """size: px of the longer side of the input; kind: of `inputs`. Raises InputError for what cannot be drawn or
        counted.
        """
        self.name = name
        self.document = Document(data, name, size)
        self.counts: Counts = count(self.document)
        with_ground(self.document, kind)
        self.input: np.ndarray = input_of(self.document, kind)
        self.drawn: dict[int, np.ndarray] = {scale: self.document.draw(scale) for scale in (1, 2, 4)}
        self.opaque: Opaque = opaque_inside(self.document)
        self.pieces: Pieces | None = pieces_of(self.document)


@dataclass(frozen=True, eq=False)
class Drawn:
    """What a tool made: the SVG, and the seconds it took, by the clock and of the processor."""

    svg: bytes
    seconds: float
    cpu_seconds: float


def run_tool(tool: Tool, truth: Truth) -> Drawn:
    """Vectorizes the input of `truth`; raises whatever the tool raises."""
    wall, cpu = time.perf_counter(), time.process_time()
    svg = tool(truth.input)
    return Drawn(svg, time.perf_counter() - wall, time.process_time() - cpu)


def measure(truth: Truth, name: str, made: Drawn) -> Figures:
    """The figures of the SVG that the tool `name` made; InputError where it cannot be drawn or counted."""
    document = Document(made.svg, f"{truth.name} by {name}", max(truth.document.width, truth.document.height))
    drawn = {scale: document.draw(scale) for scale in (1, 2, 4)}
    counts, artist = count(document), truth.counts
    seams = seam_areas(document, truth.opaque, drawn)
    structure = _structure(truth, document)
    return Figures(
        picture=truth.name,
        tool=name,
        delta_e=mean_delta_e(truth.drawn[2], drawn[2]),
        psnr_1x_db=psnr(truth.drawn[1], drawn[1]),
        psnr_4x_db=psnr(truth.drawn[4], drawn[4]),
        shapes_ratio=counts.shapes / max(1, artist.shapes),
        coordinates_ratio=counts.coordinates / max(1, artist.coordinates),
        bytes_ratio=counts.bytes / artist.bytes,
        seconds=made.seconds,
        cpu_seconds=made.cpu_seconds,
        seam_1x_px=seams[0],
        seam_4x_px=seams[1],
        seam_16x_px=seams[2],
        edge_px=edge_displacement(truth.drawn[2], drawn[2], 2),
        exact_inks=exact_inks(truth.drawn[2], drawn[2]),
        primitive_recall=structure[0],
        primitive_precision=structure[1],
        restored=structure[2],
        exposed=structure[3],
        shapes=counts.shapes,
        coordinates=counts.coordinates,
        primitives=counts.primitives,
        gzipped_bytes=counts.bytes,
        artist_shapes=artist.shapes,
        artist_coordinates=artist.coordinates,
        artist_primitives=artist.primitives,
        artist_gzipped_bytes=artist.bytes,
    )


def _structure(truth: Truth, document: Document) -> tuple[float | None, float | None, float | None, float | None]:
    """Primitives' recall and precision, the share of covered pieces that are whole, and that of wrong area exposed."""
    pieces = pieces_of(document)
    if truth.pieces is None or pieces is None:
        return None, None, None, None
    found, wanted, right, written = primitive_counts(truth.document, truth.pieces, document, pieces)
    whole, covered = restored(truth.pieces, pieces)
    return _share(found, wanted), _share(right, written), _share(whole, covered), exposed(truth.pieces, pieces)


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
