"""The comment that says which program, seed, settings and input made a file, and how to find it again.

The mark in a PNG is its Software text, in a JSON file its "program" member. Imports nothing heavy: the
command line uses this before anything is loaded.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from cubicsplat_cli._version import __version__

PROGRAM = "cubicsplat"
GZIP = b"\x1f\x8b"  # what every gzip file begins with
# The mark sits in the first lines of every file we write; a longer search would only cost time.
HEAD_BYTES = 4096

_MADE = re.compile(rb"cubicsplat \S+, of [0-9a-f]{64}")
_CHECKSUM = re.compile(rb"<!-- cubicsplat [^>]*?(, checksum ([0-9a-f]{12})) -->")


def settings_hash(settings: Mapping[str, Any]) -> str:
    """Twelve hexadecimal digits that identify the `settings` that decide a file: SHA-256 of their canonical JSON.

    The file is the same for every number of threads, and on one engine for every device of its kind.
    """
    decisive = {name: value for name, value in settings.items() if name not in ("device", "threads")}
    text = json.dumps(decisive, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def made_mark(about: str) -> str:
    """The mark of a file that was made of another one. about: that one's SHA-256, or what else it shows."""
    return f"{PROGRAM} {__version__}, of {about}"


def holds_made_mark(data: bytes) -> bool:
    """Whether the bytes hold the mark of a file that was made of another one."""
    return _MADE.search(data) is not None


def sha256_of(data: bytes) -> str:
    """SHA-256 in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def provenance_comment(version: str, seed: int, digest: str, sha256: str) -> str:
    """The text of the SVG's comment: version, seed, settings hash, and the SHA-256 of the input's bytes."""
    return f"{PROGRAM} {version}, seed {seed}, settings {digest}, input {sha256}"


def with_checksum(svg: str) -> str:
    """An SVG whose first comment, which is ours, also says the first digits of the SHA-256 of all the rest."""
    return svg.replace(" -->", f", checksum {_short(svg.encode())} -->", 1)


def is_edited(svg: bytes) -> bool:
    """Whether the text of an SVG of ours is not what its checksum says, or says none."""
    match = _CHECKSUM.search(svg[:HEAD_BYTES])
    return match is None or _short(svg[: match.start(1)] + svg[match.end(1) :]) != match[2].decode()


def _short(data: bytes) -> str:
    return sha256_of(data)[:12]


def svg_is_ours(head: bytes) -> bool:
    """Whether the first bytes of a file are those of an SVG that carries our comment."""
    return f"<!-- {PROGRAM} ".encode() in head[:HEAD_BYTES]
