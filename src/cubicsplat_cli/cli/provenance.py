"""The comment that says which program, seed and settings made a file, and how to find it again.

The mark in a PNG is its Software text, in a JSON file its "program" member. Imports nothing heavy: the
command line uses this before torch is loaded.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

PROGRAM = "cubicsplat"
# The mark sits in the first lines of every file we write; a longer search would only cost time.
HEAD_BYTES = 4096


def settings_hash(settings: Mapping[str, Any]) -> str:
    """Twelve hexadecimal digits that identify `settings`: SHA-256 of its canonical JSON (keys sorted)."""
    text = json.dumps(settings, sort_keys=True, separators=(",", ":"), default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def provenance_comment(version: str, seed: int, digest: str) -> str:
    """The text of the SVG's comment: version, seed and settings hash."""
    return f"{PROGRAM} {version}, seed {seed}, settings {digest}"


def svg_is_ours(head: bytes) -> bool:
    """Whether the first bytes of a file are those of an SVG that carries our comment."""
    return f"<!-- {PROGRAM} ".encode() in head[:HEAD_BYTES]
