"""`cubicsplat vectorize`: pictures become SVGs, their rendered PNGs and JSONs of figures."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Quiet, Verbose, argument, option, override, print_names, takes_options
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.names import parse_formats
from cubicsplat_cli.files.paths import format_of
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.jobs.plan import plan, with_masks
from cubicsplat_cli.options import BOTH, COMMON, FILES, Setting

_JOBS = Setting("count", "", least=1, most=1024, optional=True)

Overrides = Annotated[
    list[str],
    option("--set NAME=VALUE", "Change the recipe; `--set help` lists it.", BOTH, callback=print_names, is_eager=True),
]


@takes_options()
def vectorize(
    inputs: Annotated[
        list[str], argument("IN...", "Pictures, folders, patterns such as 'photos/*.png', or - for standard input.")
    ],
    output: Annotated[
        str | None, option("--output -o OUT", "SVG to write (with OUT.pdf: that too), folder, or - for stdout.", COMMON)
    ] = None,
    recursive: Annotated[bool, option("--recursive -r", "Search folders at any depth.", COMMON)] = False,
    jobs: Annotated[int | None, option("--jobs -j N", "Pictures at a time.  [default: 1]", COMMON)] = None,
    cluster: Annotated[
        str | None, option("--cluster ADDRESS", "Run on a Ray cluster: host:port or auto.", hidden=True)
    ] = None,
    overrides: Overrides = [],  # noqa: B006 (Typer's default of a list)
    also: Annotated[list[str], option("--also FORMAT,...", "Also write pdf, ps, eps, dxf, xml (Android).", FILES)] = [],  # noqa: B006 (Typer's default of a list)
    svg_only: Annotated[bool, option("--svg-only", "Write no PNG and no JSON.", FILES)] = False,
    dry_run: Annotated[bool, option("--dry-run", "Only list what would be made.", FILES)] = False,
    json: Annotated[bool, option("--json", "Print the figures as lines of JSON.", FILES)] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
    **options: Any,
) -> None:
    """Turn pictures into SVGs of Bezier shapes.

    Writes OUT.svg, OUT.png (the SVG drawn by an independent renderer) and OUT.json (figures); -o OUT.pdf, .ps, .eps,
    .dxf or .xml (Android) writes that too. Leaves alone what an earlier run made with the same settings. Ctrl-C ends
    early and writes the best SVG so far.
    """
    if "" in inputs or output == "":
        # Path("") is the current folder, which an unset shell variable does not mean.
        raise UsageError("a file name is empty; is a variable not set?")
    _JOBS.check("jobs", jobs)
    values = {**options, **dict(map(override, overrides))}
    values["png"] = values["png"] and values["measure"] and not svg_only
    values["metrics"] = values["metrics"] and not svg_only
    if values["weights"] is not None and Path(values["weights"]).is_dir():
        values["masks"] = Path(values.pop("weights"))
    values["also"] = parse_formats(also)
    request = request_of(values)
    from cubicsplat_cli.cli.run import BatchRun, check_stdout
    from cubicsplat_cli.files.read import read_stdin

    planned = plan(inputs, output, request, recursive=recursive)
    if request.masks is not None:
        planned = with_masks(planned, request.masks)
    formats = {form for job in planned.jobs for path in job.outputs.exports if (form := format_of(path))}
    if formats:
        from cubicsplat_cli.export.formats import check_packages

        check_packages(formats)
    check_stdout(planned, json=json, cluster=cluster is not None, uri=request.data_uri)
    if planned.jobs and planned.jobs[0].path is None:
        planned = replace(planned, jobs=[replace(planned.jobs[0], data=read_stdin(request.max_pixels))])
    reporter = Reporter(quiet=quiet, verbose=verbose, bars=not (json and sys.stdout.isatty()))
    code = BatchRun(planned, request, reporter, jobs, cluster, json=json, dry_run=dry_run).go()
    if code:
        raise typer.Exit(code)
