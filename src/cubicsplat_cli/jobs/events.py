"""What happens while pictures are vectorised, for whoever shows it; the methods as they are do nothing."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager

from cubicsplat_cli.progress import Progress


class Events:
    """job: the name of the picture's job, as `Job.name`."""

    def begin(self, job: str) -> None:
        """Its work begins; or begins again."""

    def stage(self, job: str, stage: str) -> None:
        """A stage of it begins: read, start (the engine is loaded), fit, write, draw, measure, animation or report."""

    def step(self, job: str, progress: Progress) -> None:
        """How far its fit is."""

    def note(self, job: str, text: str) -> None:
        """Something the user should know that is no error."""

    def detail(self, job: str, text: str) -> None:
        """Something for those who want to know everything."""


class _Notes(logging.Handler):
    def __init__(self, events: Events, job: str) -> None:
        super().__init__(logging.WARNING)
        self._events, self._job = events, job

    def emit(self, record: logging.LogRecord) -> None:
        self._events.note(self._job, record.getMessage())


@contextmanager
def logged_to(events: Events, job: str) -> Iterator[None]:
    """Within, what the library logs is a note on this job."""
    log, handler = logging.getLogger("cubicsplat"), _Notes(events, job)
    log.addHandler(handler)
    try:
        yield
    finally:
        log.removeHandler(handler)
