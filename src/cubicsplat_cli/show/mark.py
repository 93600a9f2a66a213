"""The comment by which a page is known. Imports nothing heavy: a run looks for it before there is anything to do."""

from __future__ import annotations

from cubicsplat_cli._version import __version__
from cubicsplat_cli.files.marks import PROGRAM


def page_mark(about: str) -> str:
    """The comment of a page of ours. about: the SHA-256 of the file that it shows, or what else it is about."""
    return f"<!-- {PROGRAM} {__version__}, a page about {about} -->"
