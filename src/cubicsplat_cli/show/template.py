"""The templates of the pages; whatever they are given is text until they say otherwise."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import Any

from jinja2 import Environment, PackageLoader, StrictUndefined

_INDENTATION = re.compile(r"\n\s+")


def rendered(template: str, **values: Any) -> str:
    """The text of a template, without the spaces that only its authors need; a value that it asks for and does not get
    is an error.
    """
    return _INDENTATION.sub("\n", _environment().get_template(template).render(**values))


@lru_cache(maxsize=1)
def _environment() -> Environment:
    loader = PackageLoader("cubicsplat_cli.show")
    return Environment(loader=loader, autoescape=True, undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)
