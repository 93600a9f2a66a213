"""The artwork style: few clean shapes, in as few bytes as asked for; the pixel style; and pictures of one colour."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache, partial
from typing import TYPE_CHECKING, Any
from xml.etree.ElementTree import Element

from cubicsplat_cli.artwork import structure
from cubicsplat_cli.artwork.geometry.outlines import Ring
from cubicsplat_cli.artwork.geometry.steps import suggested_precision
from cubicsplat_cli.artwork.geometry.stroke import Chain
from cubicsplat_cli.artwork.input.cells import Cells, cells_of, forced_cells
from cubicsplat_cli.artwork.regions.fewer import nearest_in
from cubicsplat_cli.artwork.scene import picture_of
from cubicsplat_cli.artwork.settings import CUTOUT
from cubicsplat_cli.artwork.shapes import Drawing, scaled_drawing
from cubicsplat_cli.artwork.style import ARTWORK, PHOTO, Style, plain_drawing
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import with_levels
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.formatting import hex_text
from cubicsplat_cli.pipeline.likeness import file_db, plain_picture
from cubicsplat_cli.pipeline.task import TOO_FINE, Made, Task
from cubicsplat_cli.progress import Work, nothing, under_way, work
from cubicsplat_cli.request import COLOR, KEEP, OBJECT, REMOVE, Request
from cubicsplat_cli.scene.paint import Rgba
from cubicsplat_cli.settings import cpu_count
from cubicsplat_cli.svg.drawing_writer import elements_of, write_mosaic
from cubicsplat_cli.svg.markup import minified, titled
from cubicsplat_cli.svg.values import hex_colour

if TYPE_CHECKING:
    from cubicsplat_cli.artwork.input.prepare import PreparedInput

SAMPLES = 48  # edges per cubic in the engine's own picture
MANY = 1000  # pieces; the finish of more takes longer than a check that they are worth it


def drawn_artwork(task: Task, on_sketch: Callable[[Made], None] = nothing) -> Made:
    """Draw few opaque shapes with exact outlines, or cells if the picture consists of them; see `drawn_outlines`."""
    # Cells never join their neighbours, as `min_area` asks of small regions.
    cells = None if task.request.artwork.min_area else cells_of(task.pixels)
    return drawn_outlines(task, on_sketch) if cells is None else drawn_cells(task, cells)


def drawn_pixels(task: Task) -> Made:
    """Draw the cells of a picture, single pixels if it has no larger ones. Raises InputError if these are too many."""
    cells = cells_of(task.pixels)
    if cells is not None:
        return drawn_cells(task, cells)
    made = drawn_cells(task, cells := forced_cells(task.pixels))
    notes = [] if cells.side > 1 else ["drawn pixel by pixel: it is not made of larger cells"]
    return replace(made, notes=[*notes, *made.notes])


def drawn_cells(task: Task, cells: Cells) -> Made:
    """Draw the cells of a picture exactly, in at most the requested number of colours."""
    from cubicsplat_cli.artwork.mosaic import finer, mosaic, with_ground  # which few drawings need

    request, chosen = task.request, task.request.artwork
    most = [n for n in (chosen.colors, request.settings.curves) if n is not None]
    cells = cells.limited(min(most, default=None)).in_palette(chosen.palette, chosen.palette_tolerance)
    notes = cells.notes
    if request.group_by == OBJECT:
        notes.append("--group-by object is of shapes, but pixel art has one path a colour")
    if request.ground != KEEP:
        cells, has_ground = with_ground(cells, None if request.ground == REMOVE else hex_colour(request.ground))
        notes += _ground_notes(request, has_ground)
    if request.overlap is not None:
        cells = finer(cells, request.overlap * task.target.width / task.picture.width)
    drawing = mosaic(cells, *task.picture.size, abutting=chosen.stacking == CUTOUT and request.overlap is None)
    write = partial(write_mosaic, drawing, precision=request.precision, grouped=request.group_by == COLOR)
    facts = _facts(len(drawing.layers), drawing.corners, drawing.fills)
    return Made(drawing.scene(), 1, write, len(drawing.layers), notes, facts)


def prepared_of(task: Task) -> PreparedInput:
    """Return the pixels of a picture, prepared to be drawn; see `prepare`."""
    from cubicsplat_cli.artwork.vectorize import prepare  # photos may do without

    return prepare(task.pixels, task.target.compression, partial(task.once, plain_picture))


def drawn_outlines(
    task: Task,
    on_sketch: Callable[[Made], None] = nothing,
    completed: Callable[[Drawing], Drawing] | None = None,
    *,
    of_few: bool = False,
) -> Made:
    """Draw regions with smooth outlines.

    on_sketch: is given a first version of a drawing of very many pieces, or of any (of_few); what it raises ends the
    drawing. completed: returns a changed drawing, in px of the target, before it is scaled to the picture.
    """
    from cubicsplat_cli.artwork.vectorize import versions

    request, size = task.request, task.picture.size
    chosen = replace(request.artwork, curves=request.settings.curves, strokes=request.strokes)
    deadline, threads = time.perf_counter() + task.seconds_to_make(), request.settings.threads or cpu_count()
    with under_way(Work(task.on_progress, deadline, threads)) as work:
        prepared = task.once(prepared_of)
        damage: dict[str, Any] = {
            "blur": prepared.mean_scale * prepared.condition.blur,
            "small": with_levels(task.target, prepared.levels) if prepared.upscale_factor > 1 else None,
            "unavoidable_error": prepared.unavoidable_error,
            "may_be_photo": not prepared.scanned,
            "of_scan": prepared.scanned,
        }

        def add_sketch(sketch: Drawing) -> None:
            if of_few or sketch.segments > MANY:
                on_sketch(replace(result_of_drawing(scaled_drawing(sketch, *size), request), **damage))

        drawings = versions(task.pixels, chosen, prepared, on_sketch=add_sketch)
        whole = drawings if completed is None else map(completed, drawings)
        made = within_budget(task, (_structured(scaled_drawing(drawing, *size), request) for drawing in whole))
    notes = [*prepared.notes, *made.notes]
    if work.stopped and not work.interrupted:
        notes.append("ended by the time limit: not all of its outlines are fitted")
    if not made.facts["shapes"]:
        notes.append(f"no shapes: {TOO_FINE}, but as a photo it can be")
    return replace(made, notes=notes, interrupted=work.interrupted, **damage)


def result_of_one_fill(fill: Rgba, task: Task) -> Made:
    """Return the result for a picture of one colour: its ground and no curve, in either style."""
    request, size = task.request, task.picture.size
    style = Style(ARTWORK, "of one colour") if request.style == "auto" else Style(request.style, "asked for")
    if style.name == PHOTO:
        return replace(result_of_drawing(plain_drawing(fill, *size), request), paths=0, facts={}, style=style)
    if request.artwork.palette:
        fill = nearest_in(request.artwork.palette, fill, request.artwork.palette_tolerance)
    return replace(_structured(plain_drawing(fill, *size), request), style=style)


def _structured(drawing: Drawing, request: Request) -> Made:
    """Return a drawing with the requested ground, cut, order and groups, as a result with notes."""
    ground = structure.ground_of(drawing)
    fill = None if request.ground in (KEEP, REMOVE) else (*hex_colour(request.ground), 255)
    if fill is not None and ground is None:
        drawing, ground = structure.on_ground(drawing, fill), fill
    if request.group_by == OBJECT:
        drawing = structure.grouped_by_object(drawing, ground)
    precision = _precision(drawing, request)
    if request.artwork.stacking == CUTOUT:
        from cubicsplat_cli.artwork.planar.cutout import cut_out

        drawing = cut_out(drawing, precision)
    if request.ground != KEEP and ground is not None:
        drawing = structure.with_ground(drawing, ground, fill)
    if request.overlap is not None:
        from cubicsplat_cli.artwork.planar.cutout import overlapping

        drawing = overlapping(structure.by_lightness(drawing), request.overlap, precision)
    if request.group_by == COLOR:
        drawing = structure.grouped_by_colour(drawing)
    return replace(result_of_drawing(drawing, request), notes=_ground_notes(request, ground is not None))


def _precision(drawing: Drawing, request: Request) -> int:
    """Return the decimals of the file; one less than usual under a limit of bytes."""
    usual = suggested_precision(drawing.width, drawing.height)
    return max(0, usual - (request.max_bytes is not None)) if request.precision is None else request.precision


def _ground_notes(request: Request, has_ground: bool) -> list[str]:
    """Return notes on a ground that is removed or painted."""
    if request.ground == KEEP:
        return []
    if request.ground == REMOVE and not has_ground:
        return ["there is no ground to remove: nothing fills the picture behind all else"]
    return ["PSNR and SSIM are low: they compare the SVG with the picture, which has another ground"]


def result_of_drawing(drawing: Drawing, request: Request) -> Made:
    """Return a finished drawing as a result."""
    facts = _facts(len(drawing.shapes), drawing.segments, drawing.fills) | {
        "primitives": sum(not isinstance(path, (Ring, Chain)) for shape in drawing.shapes for path in shape.paths),
        "gradients": len(drawing.gradients),
        "strokes": sum(shape.stroke is not None for shape in drawing.shapes),
    }
    if shaded := [shape.name for shape in drawing.shapes if shape.shading is not None]:
        facts["shaded"] = shaded

    @cache  # asked for the size before the file is written
    def elements() -> Element:
        return elements_of(drawing, _precision(drawing, request))

    def write(title: str, comment: str) -> str:
        text = titled(elements(), title, comment)
        return minified(text) if request.tiny else text

    scene = picture_of(drawing) if drawing.shapes else None
    return Made(scene, SAMPLES, write, len(drawing.shapes), facts=facts, banded=drawing.banded)


def _facts(shapes: int, segments: int, fills: tuple[Rgba, ...]) -> dict[str, Any]:
    """Return the report's members on a drawing whose shapes are paths of one colour each."""
    inks = [hex_text(fill) for fill in fills]
    return {"shapes": shapes, "segments": segments, "primitives": 0, "gradients": 0, "strokes": 0, "inks": inks}


def within_budget(task: Task, versions: Iterator[Made]) -> Made:
    """Return the last version with the requested PSNR, if one is requested, else the first within the requested bounds.
    A note says if none does. Raises InputError if not even the simplest fits. versions: from rich to simple.
    """
    least = task.request.target_psnr
    if least is not None:
        made = next(versions)
        level = file_db(task, task.text(made.write))
        if level < least:
            note = f"reached {level:.2f} dB of the {least:g} dB asked for; more --detail or --style photo may reach it"
            return made.with_note(note)
        for simpler in versions:
            if file_db(task, task.text(simpler.write)) < least:
                break
            made = simpler
        return made
    for made in versions:
        if (has := _excess(task, made)) is None:
            return made
    if work().stopped:
        return made.with_note(f"the time was too short to simplify it: it has {has}")
    raise InputError(f"not even the simplest drawing fits; allow at least {has}")


def _excess(task: Task, made: Made) -> str | None:
    """Return the number of bytes or nodes of a version if it exceeds the request's limit; else None."""
    request = task.request
    if request.max_nodes is not None and made.facts["segments"] > request.max_nodes:
        return f"{made.facts['segments']} nodes"
    if request.max_bytes is None:
        return None
    size = len(packed(task.text(made.write), compressed=request.counts_compressed))
    return f"{size} bytes" if size > request.max_bytes else None
