"""`cubicsplat eval`: how close SVGs or pictures are to their references."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, MaxPixels, Quiet, Renderer, argument, check_csv, option, write_csv
from cubicsplat_cli.errors import CubicSplatError, InputError, UsageError
from cubicsplat_cli.files.names import STDIO, match_folders
from cubicsplat_cli.files.read import looks_like_svg, read_file, read_stdin, unpacked
from cubicsplat_cli.formatting import level_text, mean, one_line
from cubicsplat_cli.metrics import NAMES, USUAL, Quality, chosen_metrics, figures_text, head, plain, to_json
from cubicsplat_cli.settings import MAX_PIXELS, SCALE, FitSettings

if TYPE_CHECKING:
    from cubicsplat_cli.evaluate.comparison import Change, Comparison

Compare = Callable[[Path, Path], "Comparison"]


class ComparedPairs(NamedTuple):
    """Results: one or more comparisons, failures as (reference, error), and candidates without a reference."""

    compared: list[Comparison]
    failed: list[tuple[Path, str]]
    extra: list[Path]


def evaluate(
    reference: Annotated[Path, argument("REFERENCE", "The picture to compare with, or a folder.")],
    candidate: Annotated[
        Path,
        argument(
            "CANDIDATE",
            "SVG (drawn at the reference's size) or picture to judge, - for standard input, or a folder whose files"
            " are matched with the references by name.",
        ),
    ],
    renderer: Renderer = "auto",
    scale: Annotated[
        int | None, option("--scale K", "Also draw an SVG this many times as large, tile by tile, and average it down.")
    ] = None,
    threads: Annotated[int | None, option("--threads N", "CPU threads of the engine.  [default: one per core]")] = None,
    metrics: Annotated[str, option("--metrics NAME,...", f"Of {', '.join(NAMES)}.")] = ",".join(USUAL),
    json: Json = False,
    csv: Annotated[Path | None, option("--csv FILE", "Also write the figures as a table, one row a pair.")] = None,
    report: Annotated[
        Path | None, option("--report OUT", "Also write a page that shows the pair: OUT.html; of two folders a folder.")
    ] = None,
    quiet: Quiet = False,
    max_pixels: MaxPixels = MAX_PIXELS,
) -> None:
    """Say how close SVGs or pictures are to others: PSNR, SSIM."""
    if scale is not None:
        SCALE.check("scale", scale)
    FitSettings(threads=threads)
    folders = reference.is_dir()
    if folders and not candidate.is_dir():
        raise UsageError(f"{reference} is a folder, so the candidate must be one too, not {candidate}")
    check_csv(csv)
    chosen = chosen_metrics(metrics)
    page = None
    if report is not None:
        from cubicsplat_cli.html_report.index import planned_pages, write_pages

        page = planned_pages(report, folders=folders)
    reporter = Reporter(quiet=quiet)
    options: dict[str, Any] = {"renderer": renderer, "scale": scale, "threads": threads, "measures": chosen}
    compare: Compare = partial(_compare, reporter=reporter, max_pixels=max_pixels, **options)
    if folders:
        pairs = _folders(reference, candidate, compare, reporter, () if json else chosen)
        printed = _folder_report(reference, candidate, pairs)
    else:
        pairs = ComparedPairs([compare(reference, candidate)], [], [])
        printed = {**head(), **pairs.compared[0].public()}
        if not json:
            _show(pairs.compared[0], chosen)
    write_csv(csv, [_row(comparison) for comparison in pairs.compared])
    if page is not None:
        write_pages(page, pairs.compared, pairs.failed, threads, folders=folders)
        reporter.summary(f"to look at: {page}")
    if json:
        typer.echo(to_json(printed), nl=False)
    for path, error in pairs.failed:
        reporter.error(error if str(path) in error else f"{path}: {error}")
    if pairs.failed:
        raise typer.Exit(1)


def _compare(reference: Path, candidate: Path, reporter: Reporter, max_pixels: int, **options: Any) -> Comparison:
    """Compare one pair, and print its notes. options: of `compare_with`."""
    from cubicsplat_cli.evaluate.comparison import compare_with
    from cubicsplat_cli.files.load import load_picture

    target = load_picture(reference, max_pixels=max_pixels, smaller="compare smaller copies")
    name = "stdin" if str(candidate) == STDIO else str(candidate)
    data = unpacked(read_stdin(max_pixels), name) if str(candidate) == STDIO else read_file(candidate)
    is_svg = looks_like_svg(candidate, data)
    comparison = compare_with(target, str(reference), data, name, is_svg=is_svg, max_pixels=max_pixels, **options)
    for note in comparison.notes:
        reporter.note(note)
    return comparison


def _folders(
    reference: Path, candidate: Path, compare: Compare, reporter: Reporter, shown: Sequence[str]
) -> ComparedPairs:
    """Compare all pairs of two folders, failures or not. shown: metrics to print; without any print nothing."""
    matched, missing, extra = match_folders(reference, candidate)
    pairs = ComparedPairs([], [(path, f"nothing in {candidate} has its name") for path in missing], extra)
    for first, second in matched:
        try:
            pairs.compared.append(compare(first, second))
        except CubicSplatError as error:
            pairs.failed.append((first, one_line(error)))
            continue
        if shown:
            _show(pairs.compared[-1], shown)
    if extra:
        more = "" if len(extra) <= 3 else f" and {len(extra) - 3} more"
        reporter.note(f"without a reference: {', '.join(path.name for path in extra[:3])}{more}")
    if not pairs.compared:
        raise InputError("; ".join(f"{path}: {error}" for path, error in pairs.failed[:3]))
    if shown:
        typer.echo(_mean_line(pairs))
    return pairs


def _show(comparison: Comparison, metrics: Sequence[str]) -> None:
    """Print the chosen metrics of one pair, and its changes at scale."""
    drawn_by = [] if comparison.renderer is None else [comparison.renderer]
    usual = [part for name, part in zip(USUAL, _quality_parts(comparison.quality), strict=True) if name in metrics]
    typer.echo("  ".join([comparison.path, *usual, *figures_text(comparison.measures), *drawn_by]))
    scale = comparison.scale
    if scale is None:
        return
    changes: list[tuple[str, Change | None]] = [(comparison.renderer or "", scale.svg), ("engine", scale.engine)]
    for name, change in changes:
        if change is not None:
            size = f"  {scale.factor}x, {scale.width} x {scale.height} px"
            difference = "" if change.change_db is None else f", {change.change_db:+.3f} dB"
            native = f"(native {level_text(change.native.psnr_db)}{difference})"
            typer.echo("  ".join([size, name, *_quality_parts(change.scaled), native]))


def _quality_parts(quality: Quality) -> list[str]:
    return [
        level_text(quality.psnr_db),
        f"SSIM {quality.ssim:.4f}" if quality.ssim is not None else f"SSIM n/a ({quality.ssim_note})",
    ]


def _mean_line(pairs: ComparedPairs) -> str:
    means = _means(pairs)
    parts = [f"mean of {means['pairs']}"]
    parts += [] if means["psnr_db"] is None else [f"{means['psnr_db']:.2f} dB"]
    parts += [] if means["ssim"] is None else [f"SSIM {means['ssim']:.4f}"]
    parts += figures_text(means)
    for name in ("svg", "engine"):
        change = means[f"{name}_change_db"]
        parts += [] if change is None else [f"{name} {change:+.3f} dB at scale"]
    return "  ".join(parts)


def _means(pairs: ComparedPairs) -> dict[str, Any]:
    """Return the means of the pairs that have a figure; an identical pair has no PSNR and is counted apart."""
    qualities = [comparison.quality for comparison in pairs.compared]
    scales = [comparison.scale for comparison in pairs.compared if comparison.scale is not None]
    means = {
        "pairs": len(qualities),
        "identical": sum(quality.identical for quality in qualities),
        "psnr_db": mean(quality.psnr_db for quality in qualities),
        "ssim": mean(quality.ssim for quality in qualities),
        **{name: mean(each.measures[name] for each in pairs.compared) for name in pairs.compared[0].measures},
        "svg_change_db": mean(scale.svg.change_db for scale in scales),
        "engine_change_db": mean(scale.engine.change_db for scale in scales if scale.engine is not None),
    }
    return {name: plain(value, name) for name, value in means.items()}


def _folder_report(reference: Path, candidate: Path, pairs: ComparedPairs) -> dict[str, Any]:
    return {
        **head(),
        "reference": {"path": str(reference)},
        "candidate": {"path": str(candidate)},
        "mean": _means(pairs),
        "pairs": [comparison.public() for comparison in pairs.compared],
        "failed": [{"reference": str(path), "error": error} for path, error in pairs.failed],
        "extra": [str(path) for path in pairs.extra],
    }


def _row(comparison: Comparison) -> dict[str, Any]:
    """Return the row of a pair in the CSV table."""
    quality, scale = comparison.quality, comparison.scale
    engine = None if scale is None else scale.engine
    return {
        "reference": comparison.reference_path,
        "candidate": comparison.path,
        "kind": comparison.kind,
        "width": comparison.reference.width,
        "height": comparison.reference.height,
        "bytes": len(comparison.data),
        "renderer": comparison.renderer,
        "psnr_db": quality.psnr_db,
        "ssim": quality.ssim,
        "identical": quality.identical,
        **comparison.measures,
        "scale": None if scale is None else scale.factor,
        "scaled_psnr_db": None if scale is None else scale.svg.scaled.psnr_db,
        "scaled_ssim": None if scale is None else scale.svg.scaled.ssim,
        "engine_psnr_db": None if engine is None else engine.native.psnr_db,
        "engine_scaled_psnr_db": None if engine is None else engine.scaled.psnr_db,
    }
