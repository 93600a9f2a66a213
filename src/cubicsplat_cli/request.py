"""The request for one or more pictures: options, their own values, and conflicts. Imports nothing heavy."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.artwork.settings import CUTOUT, ArtworkSettings
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.marks import settings_hash
from cubicsplat_cli.files.paths import MOVING
from cubicsplat_cli.options import (
    COMMON,
    DRAWINGS,
    FILES,
    PHOTOS,
    STRUCTURE,
    TINY_BYTES,
    Focus,
    GzipBytes,
    check_settings,
    parse_bytes,
    parse_focus,
    setting,
    settings_of,
    word_or_colour,
)
from cubicsplat_cli.settings import ANY, MAX_PIXELS, PRECISION, FitSettings, Mode

if TYPE_CHECKING:
    from cubicsplat_cli.files.weights import Mask
    from cubicsplat_cli.svg.initial import InitialDrawing

AUTO = "auto"
STYLES = (AUTO, "photo", "artwork", "pixel")
PHOTO_PRECISION = 2
# px between a DXF and the outlines: 13 micrometres at 96 px an inch. Cutters are exact to about 100 micrometres, so a
# drawing may be cut seven times as large.
DXF_TOLERANCE = 0.05
KEEP, REMOVE, NONE = "keep", "remove", "none"
# The shapes of a group: those of one colour, or a shape and the shapes on top of it.
COLOR, OBJECT = "color", "object"
GROUPINGS = NONE, COLOR, OBJECT
CURVES, IMAGE = "curves", "image"  # what photos within a drawing become
PHOTO_PARTS = CURVES, IMAGE, NONE
MOST_SHADING = 10_000  # curves of an object
UNITS = {"px": 1.0, "mm": 25.4 / 96.0, "in": 1.0 / 96.0}  # in a px of CSS
_OF_FILES: dict[str, Any] = {"group": FILES, "decides": False}
_OF_DRAWINGS: dict[str, Any] = {"group": STRUCTURE, "of_drawings": True}
_SIDE: dict[str, Any] = {"least": 1, "most": 1_000_000}


def parse_ground(given: str) -> str:
    """Return "keep", "remove" or "#rrggbb". Raises UsageError for others."""
    return word_or_colour(given, "ground", (KEEP, REMOVE), "keep, remove")


def parse_shading(given: str | int) -> str:
    """Return "none", "auto" or a number of curves as text. Raises UsageError for others."""
    lowered = str(given).strip().lower()
    if lowered in (NONE, AUTO) or (lowered.isdecimal() and 0 < int(lowered) <= MOST_SHADING):
        return lowered
    raise UsageError(f"must be none, auto, or a number of curves from 1 to {MOST_SHADING}, not {given!r}", "shading")


def length_of(text: str) -> tuple[float, str]:
    """Return the number and the unit, "" if there is none, of a length such as `80mm`. Raises UsageError for others."""
    match = re.fullmatch(r"(\d+(?:\.\d*)?|\.\d+)\s*(px|mm|in)?", text.strip(), re.IGNORECASE)
    number, unit = (float(match[1]), (match[2] or "").lower()) if match else (0.0, "")
    if not 0.1 <= number / UNITS[unit or "px"] <= 1_000_000.0:
        raise UsageError(f"must be a length such as 80mm, 3in or 400px, of at most a million px, not {text!r}", "width")
    return number, unit


def parse_width(given: str | float) -> str:
    """Return the shortest text of a length. Raises UsageError for other texts."""
    number, unit = length_of(str(given))
    return length_text(number, "") + unit


def length_text(number: float, unit: str) -> str:
    """Return `80mm`, `135.46667mm`, or `400` for px."""
    return f"{number:.5f}".rstrip("0").rstrip(".") + ("" if unit == "px" else unit)


@dataclass(frozen=True)
class Request:
    """The values of all options, the same for every input. Raises UsageError for values that make no sense.

    settings: of a photo; artwork: of a drawing. masks: a folder that holds a mask for each picture's name. also:
    formats (`files.paths.EXPORTS`) in which the SVG is written too. The style "auto" is "photo" or "artwork" if any
    option is given that implies it (`of_photos`, `of_artwork`); layers and an overlap imply cutouts.
    """

    settings: FitSettings = field(default_factory=FitSettings)
    artwork: ArtworkSettings = field(default_factory=ArtworkSettings)
    style: str = setting(
        AUTO, "choice", "Blended curves, few opaque shapes, or square cells.", choices=STYLES, group=COMMON
    )
    html_report: bool = setting(
        False, "flag", "Also write OUT.html, which shows the result.", option="report", group=COMMON, decides=False
    )
    force: bool = setting(False, "flag", "Redo all, and replace files of other programs.", group=COMMON, decides=False)
    precision: int | None = setting(
        None, "count", "Decimals of coordinates.  [default: 2 for photos]", most=PRECISION.most
    )
    max_size: int | None = setting(None, "count", "Work on a copy with this longer side.", metavar="PX", **_SIDE)
    max_pixels: int = setting(MAX_PIXELS, "count", "Refuse larger pictures.", least=1, hidden=True, **_OF_FILES)
    frame: int | None = setting(None, "count", "Which image of a file that has several.", hidden=True, **_SIDE)
    weights: Mask | None = setting(
        None, "text", "Mask, white where detail matters; or a folder of them.", metavar="MASK", group=PHOTOS
    )
    masks: Path | None = None
    focus: Focus | None = setting(
        None, "text", "Rectangle that matters 4 times as much.", metavar="X,Y,W,H", group=PHOTOS, parse=parse_focus
    )
    init: InitialDrawing | None = setting(None, "text", "Start from this drawing.", metavar="SVG", group=PHOTOS)
    freeze: bool = setting(False, "flag", "Keep the curves of --init, and add to them.", group=PHOTOS, hidden=True)
    max_bytes: int | None = setting(
        None, "count", "As much as fits: 20k, or 400gz after gzip.", least=1, parse=parse_bytes
    )
    target_psnr: float | None = setting(
        None, "number", "As few curves or shapes as reach this PSNR.", least=1, most=60, metavar="DB"
    )
    max_nodes: int | None = setting(None, "count", "Outlines have at most so many points.", least=1, group=DRAWINGS)
    shading: str = setting(
        AUTO, "text", "Shade within outlines: none, auto, or at most N curves an object.", metavar="HOW",
        parse=parse_shading, hidden=True, group=STRUCTURE,
    )  # fmt: skip
    photo_parts: str = setting(
        CURVES, "choice", "What photos within a drawing become.", choices=PHOTO_PARTS, group=STRUCTURE, hidden=True
    )
    group_by: str = setting(NONE, "choice", "Put shapes in groups by this.", choices=GROUPINGS, **_OF_DRAWINGS)
    layers: Path | None = setting(
        None, "text", "Also an SVG of each colour, with register marks.", metavar="DIR", parse=Path, decides=False,
        **_OF_DRAWINGS,
    )  # fmt: skip
    gap_filler: bool = setting(
        False, "flag", "An overlap of 1 px: no hairlines in viewers.", hidden=True, **_OF_DRAWINGS
    )
    overlap: float | None = setting(
        None, "number", "Cutouts grow beneath their neighbours.", least=0.1, most=1000, metavar="PX",
        hidden=True, **_OF_DRAWINGS,
    )  # fmt: skip
    ground: str = setting(KEEP, "text", "keep, remove or a colour.", metavar="WHAT", parse=parse_ground, **_OF_DRAWINGS)
    units: str = setting(
        "px", "choice", "Units of width and height.", choices=tuple(UNITS), group=STRUCTURE, hidden=True
    )
    width: str | None = setting(
        None, "text", "Width of the SVG, such as 80mm or 3in.", metavar="LENGTH", parse=parse_width, group=STRUCTURE
    )
    png: bool = setting(True, "flag", "Also write the SVG as a rendered PNG.", hidden=True, **_OF_FILES)
    metrics: bool = setting(True, "flag", "Write no OUT.json.", option=" /--no-json", hidden=True, **_OF_FILES)
    measure: bool = setting(True, "flag", "Render and measure the SVG; else no PNG either.", hidden=True, **_OF_FILES)
    animation: Path | None = setting(
        None, "text", "Also write how the result develops: .webp, .gif.", metavar="FILE", parse=Path, **_OF_FILES
    )
    geometrize: Path | None = setting(
        None, "text", "Also write the --shapes as Geometrize does.", metavar="OUT.json", parse=Path,
        hidden=True, **_OF_FILES,
    )  # fmt: skip
    also: tuple[str, ...] = ()
    dxf_tolerance: float = setting(
        DXF_TOLERANCE, "number", "How far a DXF may be off the outlines.", least=0.001, most=10, metavar="PX",
        hidden=True, **_OF_FILES,
    )  # fmt: skip
    suffix: str = setting("", "text", "Add this to the names of the results.", metavar="TEXT", hidden=True, **_OF_FILES)
    skip_existing: bool = setting(False, "flag", "Skip pictures that have any SVG already.", hidden=True, **_OF_FILES)
    data_uri: bool = setting(False, "flag", "Print the SVG as a data: URI on stdout.", hidden=True, **_OF_FILES)
    compress: bool = setting(False, "flag", "Write the SVG compressed, as OUT.svgz.", option="svgz", **_OF_FILES)

    def __post_init__(self) -> None:
        check_settings(self)
        for wrong, name, text in _conflicts(self):
            if wrong:
                raise UsageError(text, name)

    def size_text(self, width: int, height: int) -> tuple[str, str]:
        """Return width and height, with their unit, of the SVG of a picture of width x height px."""
        number, unit = (width * UNITS[self.units], "") if self.width is None else length_of(self.width)
        return length_text(number, unit or self.units), length_text(number * height / width, unit or self.units)

    @property
    def may_shade(self) -> bool:
        """True if shapes may have shading: as many curves an object as asked for, or where the style is chosen too."""
        chosen = self.shading == AUTO and self.style == AUTO and not self.of_artwork()
        return (chosen or self.shading.isdecimal()) and self.settings.curves is None and self._may_be_layered

    @property
    def may_hold_photos(self) -> bool:
        """True if photos within a drawing may become curves or images."""
        return self.photo_parts != NONE and self._may_be_layered

    @property
    def _may_be_layered(self) -> bool:
        """True if a drawing's shapes may hold more than a paint: no option asks for photos, colours, groups, cutouts,
        strokes, bytes, or movies.
        """
        others = [*self.of_photos(), *(name for name in self.of_artwork() if name not in ("detail", "strokes"))]
        bounds = (self.max_bytes, self.target_psnr, self.settings.time_limit, self.animation)
        plain = not others and all(each is None for each in bounds) and not self.strokes
        return plain and self.style in (AUTO, "artwork")

    @property
    def strokes(self) -> bool | None:
        """True if lines of even width in a drawing become strokes; None: where that is shorter."""
        return self.settings.mode is Mode.OPEN or self.artwork.strokes

    def of_photos(self) -> list[str]:
        """Return the names of the given options that only the fit of a photo has."""
        names = self._given(PHOTOS)
        if self.tiny and self.settings.shapes == "polygon":
            names.remove("shapes")  # a tiny photo consists of polygons anyway
        return names if self.masks is None else ["weights", *names]

    def of_artwork(self) -> list[str]:
        """Return the names of the given options that only a drawing has."""
        return self._given(DRAWINGS)

    def _given(self, group: str) -> list[str]:
        """Return the names of a group's settings that differ from their defaults."""
        return [
            each.name
            for holder in (self, self.settings, self.artwork)
            for each, spec in settings_of(type(holder))
            if (spec.group == group or (spec.of_drawings and group == DRAWINGS))
            and getattr(holder, each.name) != each.default
        ]

    @property
    def counts_compressed(self) -> bool:
        """True if `max_bytes` limits the compressed file."""
        return self.compress or isinstance(self.max_bytes, GzipBytes)

    @property
    def tiny(self) -> bool:
        """True if a photo becomes polygons on a coarse grid, in a file without anything dispensable."""
        return isinstance(self.max_bytes, GzipBytes) and self.max_bytes < TINY_BYTES

    def with_threads(self, threads: int) -> Request:
        """Return the same request with another number of threads."""
        return replace(self, settings=self.settings.with_(threads=threads))

    def deciding(self) -> dict[str, Any]:
        """Return everything that decides the file, and the device and threads that compute it, as plain values."""
        own = {each.name: _plain(getattr(self, each.name)) for each, spec in settings_of(Request) if spec.decides}
        return {**self.settings.public(), **own, "artwork": self.artwork.public()}

    def describe(self) -> str:
        """Return the settings as a line, without the recipe's numbers, which are in the JSON."""
        chosen = {"style": self.style, **self.settings.public()}
        return ", ".join(f"{name} {value}" for name, value in chosen.items() if name != "recipe" and value is not None)

    def digest(self) -> str:
        """Return the settings hash that the files will carry: the names of other files do not matter to it."""
        contents = {"weights": self.weights and self.weights.sha256, "init": self.init and self.init.sha256}
        return settings_hash({**self.deciding(), **contents})


def _conflicts(request: Request) -> Iterator[tuple[object, str | None, str]]:
    """Yield for each combination that makes no sense: whether the request has it, the option to name, and the error."""
    fit, artwork, style, tiny = request.settings, request.artwork, request.style, request.tiny
    photo, drawing = next(iter(request.of_photos()), ""), next(iter(request.of_artwork()), "")
    text = f"is for photos, not for {style}; leave it out, or use style photo"
    yield photo and style not in ("auto", "photo"), photo, text
    if style == "pixel":
        yield from _pixel_conflicts(request)
    yield drawing and style == "photo", drawing, "is for artwork, not for photos; leave it out, or use style artwork"
    text = f"is for artwork, --{photo.replace('_', '-')} for photos; give one of them"
    yield photo and drawing, drawing, text
    others = "photos, pixels, colours, groups, cutouts, strokes, bytes, time, movies"
    text = f"is of drawings as they are; leave out options of {others}"
    yield request.shading.isdecimal() and not request.may_shade, "shading", f"{request.shading} {text}"
    text = f"image {text}"
    yield request.photo_parts == IMAGE and not request.may_hold_photos, "photo_parts", text
    asked = next((name for name in ("layers", "gap_filler", "overlap") if getattr(request, name)), None)
    cutouts = "is of cutouts, which have" if asked else "cutout has"
    of_strokes = "--strokes" if artwork.strokes else "--mode open"
    text = f"{cutouts} shapes only; leave out {of_strokes}, which is for strokes"
    yield artwork.stacking == CUTOUT and request.strokes, asked or "stacking", text
    groups = request.group_by == OBJECT
    yield request.layers and groups, "layers", "has a file for each colour; leave out --group-by object"
    asked = "gap_filler" if request.gap_filler else "overlap"
    yield request.overlap and groups, asked, "is drawn colour by colour; leave out --group-by object"
    unit = length_of(request.width)[1] if request.width else ""
    text = f"{request.width} says its own unit; leave out --units {request.units}"
    yield unit and request.units not in ("px", unit), "width", text
    text = "needs a drawing whose curves stay as they are; give it with --init"
    yield request.freeze and request.init is None, "freeze", text
    text = "are for new curves, not for those of a drawing; leave out --init"
    yield request.init is not None and fit.shapes != ANY, "shapes", text
    budgets = [name for name in ("max_bytes", "max_nodes", "target_psnr") if getattr(request, name) is not None]
    budget, second = (*budgets, "", "")[:2]
    yield second, budget, f"and --{second.replace('_', '-')} are two budgets; give one of them"
    text = "finds the number of curves itself; leave out --curves, --init and --freeze"
    yield budget and (request.freeze or request.init is not None or fit.curves is not None), budget, text
    if tiny:
        yield from _tiny_conflicts(request)
    moving = request.animation is None or request.animation.suffix.lower() in MOVING
    yield not moving, "animation", f"must end in {' or '.join(MOVING)}, not {str(request.animation)!r}"
    yield set(request.suffix) & set("/\\\0"), "suffix", f"must be the end of a file's name, not {request.suffix!r}"
    if request.geometrize is not None:
        text = "has ellipses, rectangles and triangles; choose one of them with --shapes"
        yield tiny or fit.shapes not in ("ellipse", "rectangle", "triangle"), "geometrize", text
        json = request.geometrize.suffix.lower() == ".json"
        yield not json, "geometrize", f"must end in .json, not {str(request.geometrize)!r}"
    text = "--svgz is for files; a data: URI holds text, so leave one of them out"
    yield request.data_uri and request.compress, "data_uri", text
    text = "--force makes anew what --skip-existing leaves alone; give one of them"
    yield request.force and request.skip_existing, None, text


def _pixel_conflicts(request: Request) -> Iterator[tuple[object, str, str]]:
    """Yield what pixel art cannot have, as `_conflicts` does."""
    text = "joins small regions, which pixel art keeps; use style artwork, or leave it out"
    yield request.artwork.min_area, "min_area", text
    yield request.artwork.strokes, "strokes", "are what pixel art has none of; leave it out"
    text = "open is for strokes, which pixel art has none of; leave it out"
    yield request.settings.mode is Mode.OPEN, "mode", text
    text = "leaves details out, which pixel art keeps; use style artwork, or leave it out"
    for name in ("max_bytes", "target_psnr"):
        yield getattr(request, name) is not None, name, text
    text = "object is of shapes, but pixel art has one path a colour; use color"
    yield request.group_by == OBJECT, "group_by", text


def _tiny_conflicts(request: Request) -> Iterator[tuple[object, str, str]]:
    """Yield what a file without a size, and polygons on a coarse grid, cannot have, as `_conflicts` does."""
    fit, said = request.settings, "writes no size"
    wrong = {"width": request.width is not None, "units": request.units != "px"}
    if request.style != "artwork" and not any(wrong.values()):
        said = "writes photos as polygons on a coarse grid"
        wrong = {
            "mode": fit.mode is Mode.OPEN, "fill": fit.fill != "flat", "precision": request.precision is not None,
            "shapes": fit.shapes in ("ellipse", "rectangle"), "loss": fit.loss != "l2",
        }  # fmt: skip
    below = f"does not go with --max-bytes below {TINY_BYTES // 1000}kgz, which {said}"
    for name, is_wrong in wrong.items():
        yield is_wrong, name, f"{below}; leave it out, or allow more bytes"


def _plain(value: Any) -> Any:
    """Return a value of an option for the JSON and the settings hash."""
    if isinstance(value, Focus):
        return [float(each) for each in astuple(value)]
    if isinstance(value, GzipBytes):
        return f"{value:d}gz"
    is_file = hasattr(value, "sha256")  # a mask or a drawing
    return {"name": value.name, "sha256": value.sha256} if is_file else value
