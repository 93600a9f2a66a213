"""What happens while pictures are vectorised, for whoever shows it; the methods as they are do nothing."""

from __future__ import annotations

from cubicsplat_cli.progress import Progress


class Events:
    """job: the name of the picture's job, as `Job.name`."""

    def begin(self, job: str) -> None:
        """Its work begins; or begins again."""

    def stage(self, job: str, stage: str) -> None:
        """A stage of it begins: read, fit, write, draw or measure."""

    def step(self, job: str, progress: Progress) -> None:
        """How far its fit is."""

    def note(self, job: str, text: str) -> None:
        """Something the user should know that is no error."""

    def detail(self, job: str, text: str) -> None:
        """Something for those who want to know everything."""
