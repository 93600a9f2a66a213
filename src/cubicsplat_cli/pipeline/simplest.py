"""The best drawing in a number of bytes or nodes, or the simplest that reaches a PSNR, of ever simpler versions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.read import packed
from cubicsplat_cli.pipeline.likeness import FileLevel
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.progress import work


def within_budget(task: Task, versions: Iterator[Made]) -> Made:
    """The first version where nothing bounds the drawing; else the first that keeps to the bounds, or the last that has
    the PSNR that is asked for, with a note where none does.

    Raises InputError where not even the simplest fits.
    """
    made, request = next(versions), task.request
    if request.target_psnr is not None:
        return _reaching(request.target_psnr, made, versions, task)
    while (has := _excess(task, made)) is not None:
        following = next(versions, None)
        if following is not None:
            made = following
        elif work().stopped:
            return replace(made, notes=[*made.notes, f"the time was too short to simplify it: it has {has}"])
        else:
            raise InputError(f"not even the simplest drawing fits; allow at least {has}")
    return made


def _excess(task: Task, made: Made) -> str | None:
    """The bytes or nodes of a version that has more than it may; None for others."""
    request = task.request
    if request.max_nodes is not None and made.facts["segments"] > request.max_nodes:
        return f"{made.facts['segments']} nodes"
    if request.max_bytes is None:
        return None
    size = len(packed(task.finished(made), compressed=request.counts_compressed))
    return f"{size} bytes" if size > request.max_bytes else None


def _reaching(least: float, made: Made, versions: Iterator[Made], task: Task) -> Made:
    level_of = FileLevel(task)
    level = level_of(task.finished(made))
    if level < least:
        note = f"reached {level:.2f} dB of the {least:g} dB asked for; more --detail or --style photo may reach it"
        return replace(made, notes=[*made.notes, note])
    for following in versions:
        if level_of(task.finished(following)) < least:
            break
        made = following
    return made
