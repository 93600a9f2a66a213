"""`cubicsplat vectorize`: pictures become SVGs, their rendered PNGs and JSONs of figures."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from cubicsplat_cli.amounts import parse_bytes, with_segments
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.help import BOTH, COMMON, DRAWINGS, FILES, PHOTOS
from cubicsplat_cli.cli.options import DRAWING_OPTIONS, MaxPixels, Pictures, fit_settings, takes_fit_options
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.focus import parse_focus
from cubicsplat_cli.jobs.plan import plan
from cubicsplat_cli.request import STYLE, Request
from cubicsplat_cli.settings import MAX_PIXELS, Mode, Setting

if TYPE_CHECKING:
    from cubicsplat_cli.files.weights import Mask
    from cubicsplat_cli.svg.initial import InitialDrawing

_JOBS = Setting("count", "", least=1, most=1024, optional=True)

Output = Annotated[
    str | None,
    typer.Option(
        "--output",
        "-o",
        metavar="OUT",
        help="SVG to write, a folder for it, or - for standard output; PNG and JSON are written beside it."
        "  [default: the input's name with .svg]",
        show_default=False,
        rich_help_panel=COMMON,
    ),
]
Recursive = Annotated[
    bool, typer.Option("--recursive", "-r", help="Search folders at any depth.", rich_help_panel=COMMON)
]
Jobs = Annotated[
    int | None,
    typer.Option("--jobs", "-j", metavar="N", help="Pictures at a time.  [default: 1]", rich_help_panel=COMMON),
]
Cluster = Annotated[
    str | None,
    typer.Option("--cluster", metavar="ADDRESS", help="Run on a Ray cluster: host:port or auto.", rich_help_panel=BOTH),
]
Style = Annotated[
    Literal["auto", "photo", "artwork", "pixel"],
    typer.Option("--style", case_sensitive=False, help=STYLE.help, rich_help_panel=COMMON),
]
Palette = Annotated[
    str | None,
    typer.Option(
        "--palette",
        metavar="COLOUR,...",
        help="Use these colours and no others: names or #rrggbb.",
        rich_help_panel=DRAWINGS,
    ),
]
Precision = Annotated[
    int | None,
    typer.Option(
        "--precision",
        metavar="N",
        help="Decimals of the coordinates in px.  [default: 2; for drawings, by their size]",
        rich_help_panel=BOTH,
    ),
]
MaxSize = Annotated[
    int | None,
    typer.Option(
        "--max-size", metavar="PX", help="Work on a copy scaled down to this longer side.", rich_help_panel=BOTH
    ),
]
Frame = Annotated[
    int | None,
    typer.Option(
        "--frame",
        metavar="N",
        help="Which picture of a GIF, TIFF or other file with several.  [default: 1]",
        rich_help_panel=FILES,
    ),
]
Png = Annotated[
    bool, typer.Option("--png/--no-png", help="Also write the SVG as a rendered PNG.", rich_help_panel=FILES)
]
Measure = Annotated[
    bool,
    typer.Option(
        "--measure/--no-measure",
        help="Render the SVG and measure it; --no-measure implies --no-png.",
        rich_help_panel=FILES,
    ),
]
Page = Annotated[
    bool,
    typer.Option(
        "--report",
        help="Also write OUT.html, a page that shows the result; for several pictures, an index too.",
        rich_help_panel=COMMON,
    ),
]
Animation = Annotated[
    Path | None,
    typer.Option(
        "--animation",
        metavar="FILE",
        help="Also write how the result develops, as .webp or .gif.",
        rich_help_panel=FILES,
    ),
]
Weights = Annotated[
    str | None,
    typer.Option(
        "--weights",
        metavar="MASK",
        help="A picture that is white where detail matters and black where not; or a folder of such pictures.",
        rich_help_panel=PHOTOS,
    ),
]
FocusOn = Annotated[
    str | None,
    typer.Option(
        "--focus",
        metavar="X,Y,W,H",
        help="A rectangle in px that matters 4 times as much as the rest; X,Y,W,H,FACTOR: another factor.",
        rich_help_panel=PHOTOS,
    ),
]
NoJson = Annotated[bool, typer.Option("--no-json", help="Write no OUT.json.", rich_help_panel=FILES)]
SvgOnly = Annotated[
    bool,
    typer.Option("--svg-only", help="Write nothing but the SVG.  [implies --no-png --no-json]", rich_help_panel=FILES),
]
Suffix = Annotated[
    str,
    typer.Option(
        "--suffix",
        metavar="TEXT",
        help="Add this to the names of the results: -small gives photo-small.svg.",
        show_default=False,
        rich_help_panel=FILES,
    ),
]
SkipExisting = Annotated[
    bool,
    typer.Option(
        "--skip-existing", help="Skip pictures that have an SVG already, whatever made it.", rich_help_panel=FILES
    ),
]
Init = Annotated[
    str | None,
    typer.Option(
        "--init", metavar="SVG", help="Start from this SVG, to refine, grow or shrink it.", rich_help_panel=PHOTOS
    ),
]
Freeze = Annotated[
    bool, typer.Option("--freeze", help="Leave the curves of --init as they are; add to them.", rich_help_panel=PHOTOS)
]
MaxBytes = Annotated[
    str | None,
    typer.Option(
        "--max-bytes", metavar="N", help="Use as many curves as fit into a file of this size, such as 20k.",
        rich_help_panel=PHOTOS,
    ),
]  # fmt: skip
TargetPsnr = Annotated[
    float | None,
    typer.Option("--target-psnr", metavar="DB", help="Use as few curves as reach this PSNR.", rich_help_panel=PHOTOS),
]
Svgz = Annotated[bool, typer.Option("--svgz", help="Write the SVG compressed, as OUT.svgz.", rich_help_panel=FILES)]
Force = Annotated[
    bool,
    typer.Option(
        "--force", help="Redo everything, and replace files that cubicsplat did not write.", rich_help_panel=COMMON
    ),
]
DryRun = Annotated[bool, typer.Option("--dry-run", help="Only list what would be made.", rich_help_panel=FILES)]
Json = Annotated[
    bool,
    typer.Option(
        "--json", help="Print the figures on standard output, one line of JSON per picture.", rich_help_panel=FILES
    ),
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print errors only.", rich_help_panel=FILES)]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print settings and plain progress too.", rich_help_panel=FILES)
]


def _initial_drawing(path: str, mode: str) -> InitialDrawing:
    from cubicsplat_cli.svg.initial import load_initial_drawing

    return load_initial_drawing(path, Mode(mode))


def _mask(path: str, max_pixels: int) -> Mask:
    from cubicsplat_cli.files.weights import load_mask

    return load_mask(path, max_pixels=max_pixels)


@takes_fit_options()
def vectorize(
    inputs: Pictures,
    output: Output = None,
    recursive: Recursive = False,
    jobs: Jobs = None,
    cluster: Cluster = None,
    style: Style = "auto",
    palette: Palette = None,
    precision: Precision = None,
    max_size: MaxSize = None,
    weights: Weights = None,
    focus: FocusOn = None,
    max_bytes: MaxBytes = None,
    target_psnr: TargetPsnr = None,
    init: Init = None,
    freeze: Freeze = False,
    max_pixels: MaxPixels = MAX_PIXELS,
    frame: Frame = None,
    png: Png = True,
    no_json: NoJson = False,
    svg_only: SvgOnly = False,
    suffix: Suffix = "",
    skip_existing: SkipExisting = False,
    measure: Measure = True,
    report: Page = False,
    animation: Animation = None,
    svgz: Svgz = False,
    force: Force = False,
    dry_run: DryRun = False,
    json: Json = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    **fit: Any,
) -> None:
    """Turn pictures into SVGs of Bezier shapes.

    For each picture, writes OUT.svg, OUT.png (the SVG drawn by an independent renderer) and OUT.json (the figures).
    What an earlier run made from the same picture with the same settings is left as it is. Ctrl-C ends the fit early
    and writes the best SVG so far.
    """
    if "" in inputs or output == "":
        # Path("") is the current folder, which an unset shell variable does not mean.
        raise UsageError("a file name is empty; is a variable not set?")
    _JOBS.check("jobs", jobs)
    request = Request(
        settings=fit_settings(
            with_segments({name: value for name, value in fit.items() if name not in DRAWING_OPTIONS}, max_bytes)
        ),
        artwork=ArtworkSettings(
            palette=() if palette is None else palette,  # type: ignore[arg-type]
            **{name: fit[name] for name in DRAWING_OPTIONS},
        ),
        style=style,
        precision=precision,
        max_size=max_size,
        max_pixels=max_pixels,
        frame=frame,
        png=png and measure and not svg_only,
        report=not (no_json or svg_only),
        page=report,
        animation=animation,
        compress=svgz,
        suffix=suffix,
        force=force,
        skip_existing=skip_existing,
        measure=measure,
        weights=None if weights is None or Path(weights).is_dir() else _mask(weights, max_pixels),
        masks=Path(weights) if weights is not None and Path(weights).is_dir() else None,
        focus=None if focus is None else parse_focus(focus),
        init=None if init is None else _initial_drawing(init, fit["mode"]),
        freeze=freeze,
        max_bytes=None if max_bytes is None else parse_bytes(max_bytes),
        target_psnr=target_psnr,
    )
    from cubicsplat_cli.cli.run import Run, check_stdout
    from cubicsplat_cli.files.read import read_stdin
    from cubicsplat_cli.jobs.execute import Means
    from cubicsplat_cli.jobs.masks import with_masks

    planned = plan(inputs, output, request, recursive=recursive)
    if request.masks is not None:
        planned = with_masks(planned, request.masks)
    check_stdout(planned, json=json, cluster=cluster is not None)
    if planned.jobs and planned.jobs[0].path is None:
        planned = replace(planned, jobs=[replace(planned.jobs[0], data=read_stdin(max_pixels))])
    means = Means(workers=jobs, cluster=cluster, inline=cluster is None and planned.pictures == 1)
    reporter = Reporter(quiet=quiet, verbose=verbose, bars=not (json and sys.stdout.isatty()))
    code = Run(planned, request, means, reporter, json=json, dry_run=dry_run).go()
    if code:
        raise typer.Exit(code)
