"""`--weights` with a folder: each picture has the mask of its name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.names import is_picture_name
from cubicsplat_cli.jobs.plan import Job, Plan
from cubicsplat_cli.request import Request


def with_masks(made: Plan, folder: Path) -> Plan:
    """The plan with the mask of each picture that has one: of its name, whatever it ends in, where it lies below
    `folder` as the picture does below its own. Raises UsageError where there is none for any, or two for one.
    """
    listed: dict[Path, list[Path]] = {}
    jobs = [replace(job, mask=_mask_of(job, folder, listed)) for job in made.jobs]
    if jobs and not any(job.mask for job in jobs):
        raise UsageError(f"has no picture of the name of {jobs[0].name} in {folder}, nor of any other", "weights")
    return replace(made, jobs=jobs)


def request_of(job: Job, request: Request) -> Request:
    """What is asked for of a job: the request, with the job's own mask. Raises InputError where that is no mask."""
    if job.mask is None:
        return request
    from cubicsplat_cli.files.weights import load_mask

    return replace(request, masks=None, weights=load_mask(job.mask, max_pixels=request.max_pixels))


def _mask_of(job: Job, folder: Path, listed: dict[Path, list[Path]]) -> Path | None:
    if job.path is None:
        return None
    place = folder / job.below
    if place not in listed:
        listed[place] = sorted(path for path in place.iterdir() if is_picture_name(path)) if place.is_dir() else []
    found = [path for path in listed[place] if path.stem == job.path.stem]
    same = [path for path in found if path.name == job.path.name]
    if len(found) > 1 and not same:
        raise UsageError(f"has two masks for {job.name}, {found[0]} and {found[1]}; take one away", "weights")
    return next(iter(same or found), None)
