"""Marks of the files that cubicsplat writes: in an SVG a comment with the program, seed, settings and input, in a PNG
the Software text, in a JSON file the member "program". Imports nothing heavy.
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Mapping
from typing import Any

from cubicsplat_cli._version import __version__

PROGRAM = "cubicsplat"
GZIP = b"\x1f\x8b"  # the first bytes of every gzip file
HEAD_BYTES = 4096  # every file of ours has its mark within them
MADE = re.compile(rb"cubicsplat \S+, of [0-9a-f]{64}")
_CHECKSUM = re.compile(rb"<!-- cubicsplat [^>]*?(, checksum ([0-9a-f]{12})) -->")


def settings_hash(settings: Mapping[str, Any]) -> str:
    """Return twelve hexadecimal digits that identify the settings of a file: SHA-256 of their canonical JSON.

    device and threads do not count: they do not change the file, except that every engine has files of its own.
    """
    decisive = {name: value for name, value in settings.items() if name not in ("device", "threads")}
    return _short(json.dumps(decisive, sort_keys=True, separators=(",", ":"), default=str).encode())


def made_mark(about: str) -> str:
    """Return the mark of a file that was made of another one. about: the SHA-256 of that file, or a description."""
    return f"{PROGRAM} {__version__}, of {about}"


def sha256_of(data: bytes) -> str:
    """Return the SHA-256 in hexadecimal digits."""
    return hashlib.sha256(data).hexdigest()


def provenance_comment(seed: int, digest: str, sha256: str) -> str:
    """Return the text of the SVG's comment: version, seed, settings hash, and the SHA-256 of the input's bytes."""
    return f"{PROGRAM} {__version__}, seed {seed}, settings {digest}, input {sha256}"


def with_checksum(svg: str) -> str:
    """Add the first digits of the SHA-256 of an SVG to its first comment, which must be ours."""
    return svg.replace(" -->", f", checksum {_short(svg.encode())} -->", 1)


def is_edited(svg: bytes) -> bool:
    """Return whether an SVG of ours has no checksum, or another text than its checksum says."""
    match = _CHECKSUM.search(svg[:HEAD_BYTES])
    return match is None or _short(svg[: match.start(1)] + svg[match.end(1) :]) != match[2].decode()


def _short(data: bytes) -> str:
    return sha256_of(data)[:12]


def svg_is_ours(head: bytes) -> bool:
    """Return whether the first bytes of a file are those of an SVG with our comment."""
    return f"<!-- {PROGRAM} ".encode() in head[:HEAD_BYTES]
