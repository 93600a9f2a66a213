"""What goes to stdout besides SVGs: the JSON line of a picture, and the plan of a dry run."""

from __future__ import annotations

import json
from dataclasses import dataclass

from cubicsplat_cli.files.stdout import write_stdout
from cubicsplat_cli.jobs.work import UNCHANGED, Outcome


@dataclass(frozen=True)
class Choices:
    """What the options of `vectorize` say beyond the `Request`."""

    output: str | None
    recursive: bool
    jobs: int | None
    cluster: str | None
    dry_run: bool
    json: bool


def print_outcome(outcome: Outcome) -> None:
    """What `--json` prints of a job: one line."""
    from cubicsplat_cli.evaluate.report import to_json

    value = json.loads(to_json(outcome.to_json()))
    write_stdout(json.dumps(value, separators=(",", ":")).encode() + b"\n")


def print_plan(outcome: Outcome) -> None:
    """What a dry run says of a job."""
    outputs = outcome.job.outputs
    target = "standard output" if outputs.svg is None else str(outputs.svg)
    state = "unchanged" if outcome.status == UNCHANGED else "to do"
    write_stdout(f"{state}  {outcome.job.name} -> {target}\n".encode(errors="surrogateescape"))
