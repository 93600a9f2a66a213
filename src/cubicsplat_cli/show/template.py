"""The templates of the pages; whatever they are given is text until they say otherwise."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

_INDENTATION = re.compile(r"\n\s+")
_COMMENTS = re.compile(r"(?m)^\s*// .*\n")  # of scripts, on lines of their own
_AROUND = re.compile(r"\s*([{};,])\s*|(:) ")  # what style sheets do not need spaces about


def rendered(template: str, **values: Any) -> str:
    """The text of a template, without the spaces that only its authors need; a value that it asks for and does not get
    is an error.
    """
    return _INDENTATION.sub("\n", _environment().get_template(template).render(**values))


class _Shortened(PackageLoader):
    """Loads style sheets and scripts without what only their authors need."""

    def get_source(self, environment: Environment, template: str) -> Any:
        text, *rest = super().get_source(environment, template)
        if template.endswith(".js"):
            text = _COMMENTS.sub("", text)
        elif template.endswith(".css"):
            text = _AROUND.sub(r"\1\2", text)
        return text, *rest


@lru_cache(maxsize=1)
def _environment() -> Environment:
    loader = _Shortened("cubicsplat_cli.show")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
