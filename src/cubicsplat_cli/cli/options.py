"""Choices, ranges and checks of option values; everything here runs before numpy or torch is imported."""

from __future__ import annotations

from enum import Enum

from cubicsplat_cli.errors import UsageError

MAX_CURVES = 1_000_000
MAX_STEPS = 10_000_000
MAX_SEGMENTS = 16
MIN_SAMPLES = 4
MAX_SAMPLES = 64
MAX_THREADS = 1024
MAX_SEED = 2**31 - 1
MAX_PRECISION = 6
# The picture loader's own default, repeated because importing the loader takes longer than printing help.
DEFAULT_MAX_PIXELS = 100_000_000

MAX_JOBS = 1024
MAX_SIZE = 1_000_000


class ModeChoice(str, Enum):
    """What a curve is."""

    closed = "closed"
    open = "open"


class PresetChoice(str, Enum):
    """How long and how carefully to fit."""

    draft = "draft"
    standard = "standard"
    high = "high"
    paper = "paper"


class ImportanceChoice(str, Enum):
    """What a curve's importance is."""

    loo = "loo"
    visibility = "visibility"


class FlattenChoice(str, Enum):
    """How curves become polylines."""

    uniform = "uniform"
    de_casteljau = "de-casteljau"


class EdgesChoice(str, Enum):
    """What the edges of curves look like during the fit."""

    crisp = "crisp"
    soft = "soft"


class DeviceChoice(str, Enum):
    """Where to compute."""

    auto = "auto"
    cpu = "cpu"
    cuda = "cuda"


class RendererChoice(str, Enum):
    """What draws an SVG: auto is cairosvg, or resvg where the system has no libcairo."""

    auto = "auto"
    cairosvg = "cairosvg"
    resvg = "resvg"

    def wanted(self) -> str | None:
        """The name that `rerender` takes: None for auto."""
        return None if self is RendererChoice.auto else self.value


def parse_background(text: str) -> str:
    """ "auto", "none" or "#rrggbb" from those, #rgb, or a CSS colour name; UsageError for anything else."""
    lowered = text.strip().lower()
    if lowered in ("auto", "none"):
        return lowered
    from PIL import ImageColor

    try:
        colour = ImageColor.getrgb(lowered)
    except ValueError:
        colour = ()
    if len(colour) != 3:
        raise UsageError(f"--background must be auto, none, a colour name or #rrggbb, not {text!r}")
    return "#{:02x}{:02x}{:02x}".format(*colour)
