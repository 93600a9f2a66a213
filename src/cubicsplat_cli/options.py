"""Descriptions of options, and parsers of their values: amounts of bytes, rectangles, losses, colours.

Imports nothing heavy, since the command line is built from it.
"""

from __future__ import annotations

import contextlib
import math
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import Field, astuple, dataclass, field, fields
from typing import Any, Literal

from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.formatting import did_you_mean, hex_text

Kind = Literal["count", "number", "choice", "flag", "text"]
# The groups of the help, in its order. An option of PHOTOS or DRAWINGS implies that style.
COMMON, BOTH, FILES = "Most used", "Photos and drawings", "Files"
PHOTOS, DRAWINGS = "Photos (imply --style photo)", "Drawings (imply --style artwork)"
STRUCTURE = "Structure"
GROUPS = (COMMON, BOTH, PHOTOS, DRAWINGS, STRUCTURE, FILES)
# Present names of settings by their earlier names.
RENAMED = {"thorn_reg": "spike_penalty", "geometric_reg": "crossing_penalty"}


@dataclass(frozen=True)
class Setting:
    """Description of a field that is an option, and the limits of its values.

    kind: a whole number or a number in [least, most], one of `choices`, a yes or no, or a text. metavar: the name of
    the value in the help. optional: the value may be None. auto: it may be the word "auto". group: of the help.
    of_drawings: implies the style artwork, as DRAWINGS do, in a group of both styles.

    option: its name, if that is not the field's; " /--no-NAME" for a flag that can only be taken back. hidden: the help
    leaves the option out. by_set: `--set NAME=VALUE` sets the field. hidden_option: for by_set, the option of earlier
    versions exists too. parse: turns the given value into the field's. decides: the result depends on the field.
    """

    kind: Kind
    help: str
    least: float = 0
    most: float = math.inf
    choices: tuple[str, ...] = ()
    metavar: str = "N"
    optional: bool = False
    auto: bool = False
    group: str = BOTH
    of_drawings: bool = False
    option: str = ""
    hidden: bool = False
    by_set: bool = False
    hidden_option: bool = False
    parse: Callable[[Any], Any] | None = None
    decides: bool = True

    def check(self, name: str, value: Any) -> None:
        """Raise UsageError, naming the setting, for a value that makes no sense."""
        types = int if self.kind == "count" else (int, float)
        # A bool is an int, and NaN compares as false.
        in_range = isinstance(value, types) and not isinstance(value, bool) and self.least <= value <= self.most
        fits = {"choice": value in self.choices, "flag": isinstance(value, bool), "text": True}.get(self.kind, in_range)
        if not fits and not (value is None and self.optional):
            raise UsageError(f"must be {self.values()}{', or auto' if self.auto else ''}, not {value!r}", name)

    def values(self) -> str:
        """Return `a whole number from 0 to 6`, `a number of at least 1`, or `crisp or soft`."""
        if self.kind not in ("count", "number"):
            return listed(self.choices or ("true", "false"))
        most = f"{self.most:.0f}" if self.most >= 1.0 else f"{self.most:g}"
        span = f"of at least {self.least:g}" if self.most == math.inf else f"from {self.least:g} to {most}"
        return f"{'a whole number' if self.kind == 'count' else 'a number'} {span}"

    def read(self, name: str, text: str) -> Any:
        """Return the value of a text. Raises UsageError, naming the setting, if it has none."""
        value: Any = text.strip()
        with contextlib.suppress(ValueError):
            if self.kind in ("count", "number"):
                value = int(value) if self.kind == "count" else float(value)
        if self.kind == "flag":
            flags = {"true": True, "yes": True, "on": True, "false": False, "no": False, "off": False}
            value = flags.get(value.lower(), value)
        self.check(name, value)
        return value


def listed(names: Sequence[str]) -> str:
    """Return `a, b or c`."""
    return " or ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def setting(default: Any, kind: Kind, text: str, **facts: Any) -> Any:
    """Return a field of a dataclass that is an option of the command; it is optional if its default is None."""
    return field(default=default, metadata={"setting": Setting(kind, text, **{"optional": default is None, **facts})})


def settings_of(owner: type[Any]) -> Iterator[tuple[Field[Any], Setting]]:
    """Yield the fields of a class that are settings, in the order of the help."""
    for each in fields(owner):
        if "setting" in each.metadata:
            yield each, each.metadata["setting"]


def check_settings(owner: Any) -> None:
    """Raise UsageError, naming the setting, where a setting of a dataclass has a value that makes no sense."""
    for each, spec in settings_of(type(owner)):
        spec.check(each.name, getattr(owner, each.name))


def renamed(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return the values that are not None, under the present names of their settings."""
    return {RENAMED.get(name, name): value for name, value in values.items() if value is not None}


def unknown_setting(name: str, names: Iterable[str]) -> UsageError:
    """Return the error for a name that is no setting, with the most similar name."""
    return UsageError(f"unknown setting {name!r}{did_you_mean(name, names)}")


def parse_background(text: str) -> str:
    """Return "auto", "none" (also for "transparent") or "#rrggbb". Raises UsageError for other texts."""
    word = word_or_colour(text, "background", ("auto", "none", "transparent"), "auto, none")
    return "none" if word == "transparent" else word


def word_or_colour(text: str, name: str, words: Sequence[str], shown: str) -> str:
    """Return one of the words, or "#rrggbb" (also for #rgb or a CSS colour name)."""
    lowered = text.strip().lower() if isinstance(text, str) else ""
    if lowered in words:
        return lowered
    return hex_text(parse_colour(text, name, f"must be {shown}, a colour name or #rrggbb"))


def parse_colour(text: str, name: str, form: str) -> tuple[int, int, int]:
    """Return the 8-bit sRGB of #rgb, #rrggbb or a CSS colour name. Raises UsageError, naming a setting, for other
    texts. form: how the error begins.
    """
    from PIL import ImageColor

    lowered = text.strip().lower() if isinstance(text, str) else ""
    colour: tuple[int, ...] = ()
    with contextlib.suppress(ValueError):
        colour = ImageColor.getrgb(lowered)
    if len(colour) != 3:
        raise UsageError(f"{form}, not {text!r}{did_you_mean(lowered, ImageColor.colormap)}", name)
    return colour[0], colour[1], colour[2]


TINY_BYTES = 4000  # after gzip; below it the coordinates of a photo are whole numbers of a coarse grid


class GzipBytes(int):
    """A limit of the bytes of a file after gzip."""


def parse_bytes(given: str | int) -> int:
    """Return a number of bytes, 1 to 1,000,000,000, from a number, `20k` or `1.5MB`, where k is 1000; as GzipBytes,
    which are counted after gzip, from `400gz`. Raises UsageError for anything else.
    """
    text = f"{given}gz" if isinstance(given, GzipBytes) else str(given).strip()
    plain = text[:-2] if text.lower().endswith("gz") else text
    match = re.fullmatch(r"(\d+(?:\.\d+)?)\s*(k|m)?b?", plain, re.IGNORECASE)
    factor = {"": 1, "k": 1000, "m": 1_000_000}[((match and match[2]) or "").lower()]
    amount = int(float(match[1]) * factor) if match and len(text) < 20 else 0
    if not 1 <= amount <= 1_000_000_000:
        raise UsageError(f"must be an amount of bytes such as 20k, 1.5M or 400gz, not {given!r}", "max_bytes")
    return amount if plain == text else GzipBytes(amount)


_FOCUS_FORM = "must be X,Y,W,H or X,Y,W,H,FACTOR: a rectangle in pixels of the picture, and how much more it matters"


@dataclass(frozen=True)
class Focus:
    """A rectangle in px of the picture, and the factor by which its pixels weigh more than the rest.

    Raises UsageError for an empty rectangle, a factor that is not above 0, or values that are not finite.
    """

    left: float
    top: float
    width: float
    height: float
    factor: float = 4.0

    def __post_init__(self) -> None:
        values = astuple(self)
        if not all(math.isfinite(v) for v in values) or min(self.width, self.height, self.factor) <= 0:
            raise UsageError(f"{_FOCUS_FORM}, not {','.join(f'{v:g}' for v in values)!r}", "focus")


def parse_focus(given: str | Sequence[float] | Focus) -> Focus:
    """Return a focus from `X,Y,W,H` or `X,Y,W,H,FACTOR`, text or numbers. Raises UsageError for anything else."""
    if isinstance(given, Focus):
        return given
    try:
        values = [float(part) for part in (given.split(",") if isinstance(given, str) else given)]
    except (TypeError, ValueError):
        values = []
    if len(values) not in (4, 5):
        raise UsageError(f"{_FOCUS_FORM}, not {given!r}", "focus")
    return Focus(*values)


LOSSES = ("l2", "l1", "huber", "ms-ssim")


def parse_loss(text: str) -> dict[str, float]:
    """Return weights, above 0, by name, in the order of `LOSSES`. Raises UsageError for anything but a mixture."""
    weights: dict[str, float] = {}
    for part in text.lower().split(",") if isinstance(text, str) else ():
        name, given, weight = part.partition(":")
        name = name.strip()
        try:
            weights[name] = float(weight) if given else 1.0 if name not in weights else math.nan
        except ValueError:
            weights[name] = math.nan
    if not weights or not set(weights) <= set(LOSSES) or not all(0.0 < w < 1e6 for w in weights.values()):
        form = f"must be {listed(LOSSES)}, or a mixture by weight such as l2:0.7,ms-ssim:0.3"
        raise UsageError(f"{form}, not {text!r}", "loss")
    if "l1" in weights and "huber" in weights:
        raise UsageError(f"takes l1 or huber, not both, since both are linear for large errors: {text!r}", "loss")
    return {name: weights[name] for name in LOSSES if name in weights}


def loss_text(weights: dict[str, float]) -> str:
    """Return the shortest text of a mixture, which is the same for equal mixtures."""
    if len(weights) == 1:
        return next(iter(weights))
    total = sum(weights.values())
    return ",".join(f"{name}:{weight / total:.6g}" for name, weight in weights.items())
