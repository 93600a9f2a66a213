"""The metrics JSON, schema 1, of `OUT.json` and `--json`, as typed values; see docs/metrics-json.md and, beside this
file, `metrics.schema.json`. Imports nothing heavy: the command reads reports before it knows whether there is work.
"""

from __future__ import annotations

import json
import math
import types
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any, TypeVar, Union, get_args, get_origin, get_type_hints

from cubicsplat_cli._version import __version__
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.marks import PROGRAM
from cubicsplat_cli.files.paths import is_file

SCHEMA = 1
USUAL = ("psnr", "ssim")


@dataclass(frozen=True)
class Metric:
    """A metric. label: in text. member: its name in the JSON. decimals: in text; the JSON has one more. worse: chooses
    the worse one of several figures.
    """

    label: str
    member: str
    decimals: int
    worse: Callable[[list[float]], float]


# The further metrics of `eval`, by the names that --metrics takes; `evaluate/perceptual.py` computes them.
FURTHER = {
    "ms-ssim": Metric("MS-SSIM", "ms_ssim", 4, min),
    "lpips": Metric("LPIPS", "lpips", 4, max),
    "de00": Metric("dE00", "de00", 3, max),
}
NAMES = (*USUAL, *FURTHER)
# Decimals of the measured figures: no metric has a higher precision.
DECIMALS = {metric.member: metric.decimals + 1 for metric in FURTHER.values()} | {
    "psnr_db": 4, "weighted_psnr_db": 4, "worst_psnr_db": 4, "ssim": 5, "agreement_db": 4, "gap_db": 4, "change_db": 4,
    "ms_per_step": 4,
}  # fmt: skip
T = TypeVar("T")


@dataclass(frozen=True)
class Input:
    """The input picture. path: as the user named it. alpha: True if any pixel is not opaque."""

    path: str
    sha256: str
    width: int
    height: int
    alpha: bool


@dataclass(frozen=True)
class Output:
    """The written files. svg, png: paths (None: not written, or standard output). bytes, paths: of the SVG; paths are
    its drawn elements: a photo's curves, or the elements of a drawing's shapes. The hashes are of the files as written;
    they tell a later run whether the files are complete. compressed_bytes: after gzip, if a limit counts them.
    """

    paths: int
    bytes: int
    svg_sha256: str
    svg: str | None = None
    png: str | None = None
    png_sha256: str | None = None
    compressed_bytes: int | None = None


@dataclass(frozen=True)
class Timing:
    """Wall-clock seconds in all and of the stages (None: no such stage), steps of the fit, and milliseconds of a step.

    read: the picture; write: the SVG; draw: the SVG, by an independent renderer; measure: PSNR and SSIM.
    """

    total_s: float
    fit_s: float
    steps: int = 0
    ms_per_step: float | None = None
    read_s: float | None = None
    write_s: float | None = None
    draw_s: float | None = None
    measure_s: float | None = None


@dataclass(frozen=True)
class Quality:
    """Similarity of a picture to its reference.

    psnr_db: peak signal-to-noise ratio in dB, None if the pictures are identical. ssim: mean structural similarity in
    [-1, 1], None, with an `ssim_note`, if the picture is too small for the window. identical: no pixel differs.
    """

    psnr_db: float | None
    ssim: float | None
    identical: bool
    ssim_note: str | None = None


@dataclass(frozen=True)
class FileQuality(Quality):
    """Quality of the SVG file. renderer: name and version."""

    renderer: str = ""


@dataclass(frozen=True)
class OwnQuality(Quality):
    """Quality of the engine's own picture. samples: edges per cubic."""

    samples: int = 0


@dataclass(frozen=True)
class Qualities:
    """Quality of the SVG and of the engine's picture. agreement_db: PSNR between the two (None: no value differs).
    gap_db: PSNR of the engine's picture above that of the SVG. weighted_psnr_db: of the SVG with the weights of the
    fit's pixels (None: the fit had none).
    """

    svg: FileQuality
    surrogate: OwnQuality
    agreement_db: float | None
    gap_db: float | None
    weighted_psnr_db: float | None = None


@dataclass(frozen=True, kw_only=True)
class Figures:
    """The base of the reports: the first members of every JSON of ours."""

    schema: int = SCHEMA
    program: str = PROGRAM
    version: str = __version__

    def public(self) -> dict[str, Any]:
        """Return plain JSON values in the order of the documentation, figures cut to their decimals."""
        return plain(self)

    def to_json(self) -> str:
        """Return strictly valid JSON, ending with a newline."""
        return to_json(self)


@dataclass(frozen=True)
class Report(Figures):
    """The figures of one vectorised picture.

    style: "photo", "artwork" or "pixel"; style_reason: why. shapes, segments, primitives, gradients, strokes, inks
    (#rrggbbaa): of artwork and pixel art, else None. shaded: names of the shapes with shading or a photo. colors: the
    picture's dominant ones, as `hex` with their `share` of its pixels. settings: of the result, with the device and
    threads, which `settings_hash` leaves out. quality: None if it was not measured. replaced, dropped: curves seeded
    anew during the fit, and left out at its end (None: unknown). history: step, psnr_db (own picture), seconds,
    replaced, and gini of the curves' importances once they are computed.
    """

    input: Input
    output: Output
    settings: dict[str, Any]
    settings_hash: str
    device: dict[str, Any]
    timing: Timing
    style: str = "photo"
    style_reason: str = ""
    shapes: int | None = None
    segments: int | None = None
    primitives: int | None = None
    gradients: int | None = None
    strokes: int | None = None
    inks: list[str] | None = None
    shaded: list[str] | None = None
    colors: list[dict[str, Any]] = field(default_factory=list)
    replaced: int = 0
    interrupted: bool = False
    quality: Qualities | None = None
    dropped: int | None = None
    notes: list[str] = field(default_factory=list)
    history: list[dict[str, float]] = field(default_factory=list)

    def count(self) -> int:
        """Return the number of curves of a photo, or of shapes of a drawing."""
        return self.output.paths if self.shapes is None else self.shapes

    @classmethod
    def from_json(cls, text: str | bytes) -> Report:
        """Read a report. Raises ValueError for any other text."""
        value = json.loads(text)
        if not isinstance(value, dict) or (value.get("schema"), value.get("program")) != (SCHEMA, PROGRAM):
            raise ValueError(f"not a report of {PROGRAM} with schema {SCHEMA}")
        return _built(cls, value)

    @classmethod
    def in_file(cls, path: Path) -> Report | None:
        """Return the report in a file; None if there is none that this version can read."""
        try:
            return cls.from_json(path.read_bytes()) if is_file(path) else None
        except (OSError, ValueError):
            return None


def head() -> dict[str, Any]:
    """Return the first members of every JSON of ours."""
    return vars(Figures())


def gap_db(svg: Quality, surrogate: Quality) -> float | None:
    """Return the PSNR of the own picture minus that of the SVG, dB; None if either is identical to the reference."""
    return None if svg.psnr_db is None or surrogate.psnr_db is None else surrogate.psnr_db - svg.psnr_db


def plain(value: Any, name: str = "") -> Any:
    """Return a value with plain containers, figures cut to their decimals, None for infinite and undefined floats, and
    no `ssim_note` that is None. name: of the value as a member, which decides its decimals.
    """
    if is_dataclass(value) and not isinstance(value, type):
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, Mapping):
        kept = {key: item for key, item in value.items() if not (key == "ssim_note" and item is None)}
        return {str(key): plain(item, str(key)) for key, item in kept.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    if isinstance(value, float):
        decimals = DECIMALS.get(name, 3 if name.endswith("_s") else None)
        if not math.isfinite(value):
            return None
        return float(value) if decimals is None else round(float(value), decimals)
    return value


def to_json(value: Any) -> str:
    """Return strictly valid JSON text, ending with a newline; numbers that are not finite become null."""
    return json.dumps(plain(value), indent=2, allow_nan=False) + "\n"


def json_line(value: Any) -> bytes:
    """Return the same without spaces, as bytes of one line."""
    return json.dumps(plain(value), separators=(",", ":"), allow_nan=False).encode() + b"\n"


def _built(kind: type[T], value: Any) -> T:
    """Return a dataclass from plain JSON values. Raises ValueError if a member is missing or of another type."""
    if not isinstance(value, dict):
        raise ValueError(f"{kind.__name__} must be an object, not {type(value).__name__}")
    # Members of newer versions are ignored.
    members = {name: _typed(hint, value[name], name) for name, hint in get_type_hints(kind).items() if name in value}
    try:
        return kind(**members)
    except TypeError as error:
        raise ValueError(f"{kind.__name__} is incomplete: {error}") from error


def _typed(hint: Any, value: Any, name: str) -> Any:
    if is_dataclass(hint):
        return _built(hint, value)  # type: ignore[arg-type]
    if get_origin(hint) in (Union, types.UnionType):
        return None if value is None else _typed(get_args(hint)[0], value, name)
    kind = get_origin(hint) or hint
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        return float(value)
    if not isinstance(value, kind) or (kind is int and isinstance(value, bool)):
        raise ValueError(f"{name} must be {kind.__name__}, not {value!r}")
    return value


def chosen_metrics(text: str) -> tuple[str, ...]:
    """Return the metrics of a list with commas, each once. Raises UsageError for an unknown name, or none."""
    names = tuple(dict.fromkeys(part.strip().lower() for part in text.split(",") if part.strip()))
    if not names or not set(names) <= set(NAMES):
        raise UsageError(f"must be of {', '.join(NAMES)}, with commas between them, not {text!r}", "metrics")
    return names


def figures_text(figures: Mapping[str, float | None]) -> Iterator[str]:
    """Yield `LPIPS 0.1234`, `MS-SSIM n/a`, and so on, for the further metrics among the figures."""
    for metric in FURTHER.values():
        if metric.member in figures:
            value = figures[metric.member]
            yield f"{metric.label} {'n/a' if value is None else f'{value:.{metric.decimals}f}'}"
