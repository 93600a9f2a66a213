"""`cubicsplat eval`: how close SVGs or pictures are to their references."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from cubicsplat_cli._version import __version__
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import DEFAULT_MAX_PIXELS, MAX_THREADS, RendererChoice
from cubicsplat_cli.errors import CubicSplatError, InputError, UsageError
from cubicsplat_cli.files.marks import PROGRAM
from cubicsplat_cli.words import one_line

if TYPE_CHECKING:
    from cubicsplat_cli.evaluate import Quality
    from cubicsplat_cli.evaluate.judge import Judgement

# The evaluation's own limit, repeated because importing it takes longer than printing help.
MAX_SCALE = 12


@dataclass(frozen=True)
class Options:
    """What holds for every pair."""

    renderer: str | None
    max_pixels: int
    scale: int | None
    threads: int | None


@dataclass
class Outcome:
    """Of two folders: judgements, failures as (reference, error), and candidates that nobody asked about."""

    judged: list[Judgement] = field(default_factory=list)
    failed: list[tuple[Path, str]] = field(default_factory=list)
    extra: list[Path] = field(default_factory=list)


def evaluate(
    reference: Annotated[Path, typer.Argument(metavar="REFERENCE", help="The picture to compare with, or a folder.")],
    candidate: Annotated[
        Path,
        typer.Argument(
            metavar="CANDIDATE",
            help="SVG (drawn at the reference's size) or picture to judge, or a folder whose files are"
            " matched with the references by name.",
        ),
    ],
    renderer: Annotated[
        RendererChoice, typer.Option("--renderer", help="What draws an SVG; auto is cairosvg where it works.")
    ] = RendererChoice.auto,
    scale: Annotated[
        int | None,
        typer.Option(
            "--scale",
            min=1,
            max=MAX_SCALE,
            help="Also draw an SVG this many times as large, tile by tile, and average it down again.",
        ),
    ] = None,
    threads: Annotated[
        int | None,
        typer.Option("--threads", min=1, max=MAX_THREADS, help="CPU threads of the engine.  [default: one per core]"),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print the figures as JSON.")] = False,
    csv: Annotated[
        Path | None, typer.Option("--csv", metavar="FILE", help="Also write the figures as a table, one row a pair.")
    ] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Print no notes, only the result and errors.")] = False,
    max_pixels: Annotated[
        int, typer.Option("--max-pixels", min=1, help="Refuse pictures with more pixels than this.")
    ] = DEFAULT_MAX_PIXELS,
) -> None:
    """Print PSNR and SSIM of SVGs or pictures against their reference pictures."""
    _check(reference, candidate, csv)
    options = Options(renderer.wanted(), max_pixels, scale, threads)
    reporter = Reporter(quiet=quiet, verbose=False)
    if reference.is_dir():
        outcome = _folders(reference, candidate, options, reporter, show=not json)
        report = _folder_report(reference, candidate, outcome)
    else:
        outcome = Outcome([_judge(reference, candidate, options, reporter)])
        report = {"schema": 1, "program": PROGRAM, "version": __version__, **outcome.judged[0].fields()}
        if not json:
            _show(outcome.judged[0])
    if csv is not None:
        _write_csv(csv, outcome)
    if json:
        from cubicsplat_cli.evaluate.report import to_json

        typer.echo(to_json(report), nl=False)
    if outcome.failed:
        for path, error in outcome.failed:
            typer.echo(f"cubicsplat: failed: {path}: {error}", err=True)
        raise typer.Exit(1)


def _check(reference: Path, candidate: Path, csv: Path | None) -> None:
    """What can be told before any work."""
    if reference.is_dir() and not candidate.is_dir():
        raise UsageError(f"{reference} is a folder, so the candidate must be one too, not {candidate}")
    if csv is None:
        return
    if csv.suffix.lower() != ".csv":
        raise UsageError(f"the table must end in .csv, but --csv is {csv}")
    from cubicsplat_cli.files.atomic import check_writable

    check_writable(csv)


def _judge(reference: Path, candidate: Path, options: Options, reporter: Reporter) -> Judgement:
    from cubicsplat_cli.evaluate.judge import judge
    from cubicsplat_cli.files.load import load_picture
    from cubicsplat_cli.files.read import looks_like_svg, read_file

    target = load_picture(reference, max_pixels=options.max_pixels)
    data = read_file(candidate)
    judgement = judge(
        target,
        str(reference),
        data,
        str(candidate),
        is_svg=looks_like_svg(candidate, data),
        renderer=options.renderer,
        max_pixels=options.max_pixels,
        scale=options.scale,
        threads=options.threads,
    )
    for note in judgement.notes:
        reporter.note(note)
    return judgement


def _folders(reference: Path, candidate: Path, options: Options, reporter: Reporter, *, show: bool) -> Outcome:
    """All pairs of two folders; one that fails does not stop the others."""
    from cubicsplat_cli.evaluate.folders import match_folders

    matches = match_folders(reference, candidate)
    outcome = Outcome(extra=matches.extra)
    outcome.failed = [(path, f"nothing in {candidate} has its name") for path in matches.missing]
    for first, second in matches.pairs:
        try:
            outcome.judged.append(_judge(first, second, options, reporter))
        except CubicSplatError as error:
            outcome.failed.append((first, one_line(error)))
            continue
        if show:
            _show(outcome.judged[-1])
    if outcome.extra:
        names = ", ".join(path.name for path in outcome.extra[:3])
        more = "" if len(outcome.extra) <= 3 else f" and {len(outcome.extra) - 3} more"
        reporter.note(f"without a reference: {names}{more}")
    if not outcome.judged:
        raise InputError("; ".join(f"{path}: {error}" for path, error in outcome.failed[:3]))
    if show:
        typer.echo(_mean_line(outcome))
    return outcome


def _show(judgement: Judgement) -> None:
    from cubicsplat_cli.evaluate.judge import Change

    drawn_by = [] if judgement.renderer is None else [judgement.renderer]
    typer.echo("  ".join([judgement.candidate_path, *_quality_parts(judgement.quality), *drawn_by]))
    scale = judgement.scale
    if scale is None:
        return
    pixels = f"{judgement.reference.width * scale.factor} x {judgement.reference.height * scale.factor} px"
    changes: list[tuple[str, Change | None]] = [(judgement.renderer or "", scale.file), ("engine", scale.engine)]
    for name, change in changes:
        if change is not None:
            typer.echo(f"  {scale.factor}x, {pixels}  {name}  {_change_text(change)}")


def _quality_parts(quality: Quality) -> list[str]:
    return [
        "identical" if quality.psnr_db is None else f"{quality.psnr_db:.2f} dB",
        f"SSIM {quality.ssim:.4f}" if quality.ssim is not None else f"SSIM n/a ({quality.ssim_note})",
    ]


def _change_text(change: Any) -> str:
    """`31.77 dB  SSIM 0.8528  (native 31.78 dB, -0.01 dB)`."""
    native = _quality_parts(change.native)[0]
    difference = "" if change.change_db is None else f", {change.change_db:+.3f} dB"
    return "  ".join([*_quality_parts(change.scaled), f"(native {native}{difference})"])


def _mean_line(outcome: Outcome) -> str:
    means = _means(outcome)
    parts = [f"mean of {means['pairs']}"]
    parts += [] if means["psnr_db"] is None else [f"{means['psnr_db']:.2f} dB"]
    parts += [] if means["ssim"] is None else [f"SSIM {means['ssim']:.4f}"]
    for name in ("svg", "engine"):
        change = means[f"{name}_change_db"]
        parts += [] if change is None else [f"{name} {change:+.3f} dB at scale"]
    return "  ".join(parts)


def _means(outcome: Outcome) -> dict[str, Any]:
    """Means over the pairs that have a figure; an identical pair has no PSNR and is counted apart."""
    qualities = [judgement.quality for judgement in outcome.judged]
    scales = [judgement.scale for judgement in outcome.judged if judgement.scale is not None]
    return {
        "pairs": len(qualities),
        "identical": sum(quality.identical for quality in qualities),
        "psnr_db": _mean([quality.psnr_db for quality in qualities], 4),
        "ssim": _mean([quality.ssim for quality in qualities], 5),
        "svg_change_db": _mean([scale.file.change_db for scale in scales], 4),
        "engine_change_db": _mean([scale.engine.change_db for scale in scales if scale.engine is not None], 4),
    }


def _mean(values: list[float | None], decimals: int) -> float | None:
    known = [value for value in values if value is not None]
    return round(sum(known) / len(known), decimals) if known else None


def _folder_report(reference: Path, candidate: Path, outcome: Outcome) -> dict[str, Any]:
    return {
        "schema": 1,
        "program": PROGRAM,
        "version": __version__,
        "reference": {"path": str(reference)},
        "candidate": {"path": str(candidate)},
        "mean": _means(outcome),
        "pairs": [judgement.fields() for judgement in outcome.judged],
        "failed": [{"reference": str(path), "error": error} for path, error in outcome.failed],
        "extra": [str(path) for path in outcome.extra],
    }


def _write_csv(path: Path, outcome: Outcome) -> None:
    from cubicsplat_cli.evaluate.table import csv_text
    from cubicsplat_cli.files.atomic import write_atomically

    rows = []
    for judgement in outcome.judged:
        quality, scale = judgement.quality, judgement.scale
        row = {
            "reference": judgement.reference_path,
            "candidate": judgement.candidate_path,
            "kind": judgement.kind,
            "width": judgement.reference.width,
            "height": judgement.reference.height,
            "bytes": judgement.size,
            "renderer": judgement.renderer,
            "psnr_db": quality.psnr_db,
            "ssim": quality.ssim,
            "identical": quality.identical,
        }
        engine = None if scale is None else scale.engine
        row |= {
            "scale": None if scale is None else scale.factor,
            "scaled_psnr_db": None if scale is None else scale.file.scaled.psnr_db,
            "scaled_ssim": None if scale is None else scale.file.scaled.ssim,
            "engine_psnr_db": None if engine is None else engine.native.psnr_db,
            "engine_scaled_psnr_db": None if engine is None else engine.scaled.psnr_db,
        }
        rows.append(row)
    write_atomically(path, csv_text(rows).encode())
