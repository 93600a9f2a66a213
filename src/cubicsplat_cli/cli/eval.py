"""`cubicsplat eval`: how close an SVG or a picture is to its reference."""

from __future__ import annotations

import hashlib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli._version import __version__
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import DEFAULT_MAX_PIXELS, RendererChoice
from cubicsplat_cli.cli.provenance import PROGRAM

if TYPE_CHECKING:
    from cubicsplat_cli.evaluate import Quality
    from cubicsplat_cli.image import Picture

# Half a percent: what rounding to whole pixels does to a small picture's shape is no mistake of the user.
_ASPECT_TOLERANCE = 0.005


def evaluate(
    reference: Annotated[Path, typer.Argument(metavar="REFERENCE", help="The picture to compare with.")],
    candidate: Annotated[
        Path,
        typer.Argument(metavar="CANDIDATE", help="SVG (drawn at the reference's size) or picture to judge."),
    ],
    renderer: Annotated[
        RendererChoice, typer.Option("--renderer", help="What draws an SVG; auto is cairosvg where it works.")
    ] = RendererChoice.auto,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    quiet: Annotated[
        bool, typer.Option("--quiet", "-q", help="Print no notes, only the result and errors.")
    ] = False,
    max_pixels: Annotated[
        int, typer.Option("--max-pixels", min=1, help="Refuse pictures with more pixels than this.")
    ] = DEFAULT_MAX_PIXELS,
) -> None:
    """Print PSNR and SSIM of an SVG or a picture against a reference picture."""
    from cubicsplat_cli.cli.files import looks_like_svg, read_file
    from cubicsplat_cli.evaluate.report import to_json
    from cubicsplat_cli.image import load_picture

    target = load_picture(reference, max_pixels=max_pixels)
    notes = [f"{target.source}: {note}" for note in target.notes]
    data = read_file(candidate)
    if looks_like_svg(candidate, data):
        kind = "svg"
        drawn_by, quality = _judge_svg(target, data, str(candidate), renderer.wanted(), notes)
    else:
        kind, drawn_by = "raster", None
        quality = _judge_raster(target, data, str(candidate), max_pixels, notes)
    reporter = Reporter(quiet=quiet, verbose=False)
    for note in notes:
        reporter.note(note)
    if json:
        report = _report(target, str(reference), str(candidate), kind, data, drawn_by, quality, notes)
        typer.echo(to_json(report), nl=False)
    else:
        typer.echo(_line(candidate, quality, drawn_by))


def _judge_svg(
    target: Picture, data: bytes, source: str, renderer: str | None, notes: list[str]
) -> tuple[str, Quality]:
    """The renderer's name and the quality of an SVG drawn at the reference's size; may add to `notes`."""
    from cubicsplat_cli.evaluate import compare, rerender_untrusted

    rendered, size = rerender_untrusted(
        data, source=source, width=target.width, height=target.height, renderer=renderer
    )
    if abs(size.width * target.height / (size.height * target.width) - 1.0) > _ASPECT_TOLERANCE:
        notes.append(
            f"{source}: its shape, {size.width:g} x {size.height:g}, is not that of the reference, "
            f"{target.width} x {target.height}; it is centred and leaves borders"
        )
    if rendered.note is not None:
        notes.append(rendered.note)
    return rendered.renderer, compare(target, rendered.pixels)


def _judge_raster(target: Picture, data: bytes, source: str, max_pixels: int, notes: list[str]) -> Quality:
    from cubicsplat_cli.evaluate import compare_premultiplied
    from cubicsplat_cli.image import load_picture

    picture = load_picture(data, name=source, max_pixels=max_pixels)
    notes.extend(f"{picture.source}: {note}" for note in picture.notes)
    return compare_premultiplied(target, picture.target())


def _report(
    target: Picture,
    reference: str,
    candidate: str,
    kind: str,
    data: bytes,
    drawn_by: str | None,
    quality: Quality,
    notes: list[str],
) -> dict[str, Any]:
    from cubicsplat_cli.evaluate.report import SCHEMA, input_fields, quality_fields

    return {
        "schema": SCHEMA,
        "program": PROGRAM,
        "version": __version__,
        "reference": input_fields(target, reference),
        "candidate": {
            "path": candidate,
            "sha256": hashlib.sha256(data).hexdigest(),
            "kind": kind,
            "bytes": len(data),
        },
        "quality": {"renderer": drawn_by, **quality_fields(quality)},
        "notes": notes,
    }


def _line(candidate: Path, quality: Quality, drawn_by: str | None) -> str:
    parts = [str(candidate), "identical" if quality.psnr_db is None else f"{quality.psnr_db:.2f} dB"]
    parts.append(
        f"SSIM {quality.ssim:.4f}" if quality.ssim is not None else f"SSIM n/a ({quality.ssim_note})"
    )
    if drawn_by is not None:
        parts.append(drawn_by)
    return "  ".join(parts)
