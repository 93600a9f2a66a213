"""What the documents need to become pages, beyond what mkdocs does. Called by `make docs`, see mkdocs.yml."""

from __future__ import annotations

import re

_CODE = re.compile(r"`[^`\n]*`")


def on_page_markdown(markdown: str, **_: object) -> str:
    """Bars in the code of tables without the backslash that GitHub wants there and mkdocs would show."""
    lines = markdown.split("\n")
    return "\n".join(_CODE.sub(_bare, line) if line.startswith("|") else line for line in lines)


def _bare(code: re.Match[str]) -> str:
    return code[0].replace("\\|", "|")
