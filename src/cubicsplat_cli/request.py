"""The request of a user: everything that decides a result, as a table of options. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import astuple, dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from cubicsplat_cli.artwork.settings import CUTOUT, ArtworkSettings
from cubicsplat_cli.files.marks import settings_hash
from cubicsplat_cli.options import (
    COMMON,
    CURVES,
    DRAWINGS,
    FILES,
    GROUPINGS,
    KEEP,
    NO_PHOTO_PARTS,
    NO_SHADING,
    NONE,
    PHOTO_PARTS,
    PHOTOS,
    STRUCTURE,
    TINY_BYTES,
    UNITS,
    Focus,
    GzipBytes,
    length_of,
    length_text,
    parse_bytes,
    parse_focus,
    parse_ground,
    parse_shading,
    parse_width,
    renamed,
    setting,
    settings_of,
)  # fmt: skip
from cubicsplat_cli.request_checks import check_request
from cubicsplat_cli.settings import ANY, MAX_PIXELS, PRECISION, FitSettings, Mode

if TYPE_CHECKING:
    from cubicsplat_cli.files.weights import Mask
    from cubicsplat_cli.svg.initial import InitialDrawing

STYLES = ("auto", "photo", "artwork", "pixel")
PHOTO_PRECISION = 2
TINY_STEPS = 1200  # of a fit whose polygons will lie on such a grid
# px by which a DXF may be off the outlines: 13 micrometres at 96 px an inch. Cutters repeat to about 100, so that the
# drawing may be cut seven times as large.
DXF_TOLERANCE = 0.05
_OF_FILES: dict[str, Any] = {"group": FILES, "decides": False}
_OF_DRAWINGS: dict[str, Any] = {"group": STRUCTURE, "of_drawings": True}
_SIDE: dict[str, Any] = {"least": 1, "most": 1_000_000, "optional": True}


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
        "auto", "choice", "Blended curves, few opaque shapes, or square cells.", choices=STYLES, group=COMMON
    )
    html_report: bool = setting(
        False, "flag", "Also write OUT.html, which shows the result.", option="report", group=COMMON, decides=False
    )
    force: bool = setting(False, "flag", "Redo all, and replace files of other programs.", group=COMMON, decides=False)
    precision: int | None = setting(
        None, "count", "Decimals of coordinates.  [default: 2 for photos]", most=PRECISION.most, optional=True
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
        None, "count", "As much as fits: 20k, or 400gz after gzip.", least=1, optional=True, parse=parse_bytes
    )
    target_psnr: float | None = setting(
        None, "number", "As few curves or shapes as reach this PSNR.", least=1, most=60, metavar="DB", optional=True
    )
    max_nodes: int | None = setting(
        None, "count", "Outlines have at most so many points.", least=1, optional=True, group=DRAWINGS
    )
    shading: str = setting(
        NO_SHADING, "text", "Shade within outlines: none, auto, or at most N curves an object.", metavar="HOW",
        parse=parse_shading, hidden=True, **_OF_DRAWINGS,
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
        None, "number", "Cutouts grow beneath their neighbours.", least=0.1, most=1000, metavar="PX", optional=True,
        hidden=True, **_OF_DRAWINGS,
    )  # fmt: skip
    ground: str = setting(
        KEEP, "text", "keep, remove or a colour.", metavar="WHAT", parse=parse_ground,
        **_OF_DRAWINGS,
    )  # fmt: skip
    units: str = setting(
        "px", "choice", "Units of width and height.", choices=tuple(UNITS), group=STRUCTURE, hidden=True
    )
    width: str | None = setting(
        None, "text", "Width of the SVG, such as 80mm or 3in.", metavar="LENGTH", parse=parse_width, group=STRUCTURE
    )
    png: bool = setting(True, "flag", "Also write the SVG as a rendered PNG.", hidden=True, **_OF_FILES)
    metrics: bool = setting(True, "flag", "Write no OUT.json.", option="json", only_off=True, hidden=True, **_OF_FILES)
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
        for each, spec in settings_of(Request):
            spec.check(each.name, getattr(self, each.name))
        check_request(self)

    def size_text(self, width: int, height: int) -> tuple[str, str]:
        """Width and height, with their unit, of the SVG of a picture of so many px."""
        number, unit = (width * UNITS[self.units], "") if self.width is None else length_of(self.width)
        return length_text(number, unit or self.units), length_text(number * height / width, unit or self.units)

    @property
    def may_shade(self) -> bool:
        """Whether shapes may have shading: no option asks for few shapes or colours, groups, cutouts, strokes or an
        animation.
        """
        return self.shading != NO_SHADING and self.settings.curves is None and self._is_plain

    @property
    def may_hold_photos(self) -> bool:
        """Whether photos within a drawing become curves or images: the same, but that curves may be bounded."""
        of_style = self.style in ("auto", "artwork") and not self.of_photos()
        return self.photo_parts != NO_PHOTO_PARTS and of_style and self._is_plain

    @property
    def _is_plain(self) -> bool:
        others = [name for name in self.of_artwork() if name not in ("shading", "detail", "strokes")]
        bounds = (self.max_bytes, self.target_psnr, self.settings.time_limit, self.animation)
        return not others and all(each is None for each in bounds) and not self.strokes

    @property
    def strokes(self) -> bool | None:
        """Whether lines of even width in a drawing become strokes; None for where that is shorter."""
        return self.settings.mode is Mode.OPEN or self.artwork.strokes

    def of_photos(self) -> list[str]:
        """The given options that only the fit of a photo has."""
        names = self._given(PHOTOS)
        if self.tiny and self.settings.shapes == "polygon":
            names.remove("shapes")  # which is what a photo is by itself there
        return names if self.masks is None else ["weights", *names]

    def of_artwork(self) -> list[str]:
        """The given options that only a drawing has."""
        return self._given(DRAWINGS)

    def _given(self, group: str) -> list[str]:
        """The names of a group's settings that differ from their defaults."""
        return [
            each.name
            for holder in (self, self.settings, self.artwork)
            for each, spec in settings_of(type(holder))
            if (spec.group == group or (spec.of_drawings and group == DRAWINGS))
            and getattr(holder, each.name) != each.default
        ]

    @property
    def counts_compressed(self) -> bool:
        """Whether `max_bytes` are those of the compressed file."""
        return self.compress or isinstance(self.max_bytes, GzipBytes)

    @property
    def tiny(self) -> bool:
        """Whether a photo becomes polygons on a coarse grid, in a file without all that it does not need."""
        return isinstance(self.max_bytes, GzipBytes) and self.max_bytes < TINY_BYTES

    def with_threads(self, threads: int | None) -> Request:
        """The same with so many threads; None: as asked for."""
        return self if threads is None else replace(self, settings=self.settings.with_(threads=threads))

    def deciding(self) -> dict[str, Any]:
        """Everything that decides the file, and what it is computed with, as plain values."""
        own = {each.name: _plain(getattr(self, each.name)) for each, spec in settings_of(Request) if spec.decides}
        return {**self.settings.public(), **own, "artwork": self.artwork.public()}

    def describe(self) -> str:
        """The settings as a line; the recipe's numbers are in the JSON."""
        chosen = {"style": self.style, **self.settings.public()}
        return ", ".join(f"{name} {value}" for name, value in chosen.items() if name != "recipe" and value is not None)

    def digest(self) -> str:
        """The settings hash that the files will carry."""
        # Files are the same under any name.
        named = {"weights": self.weights, "init": self.init}
        return settings_hash({**self.deciding(), **{name: each and each.sha256 for name, each in named.items()}})


def _plain(value: Any) -> Any:
    if isinstance(value, Focus):
        return [float(each) for each in astuple(value)]
    if isinstance(value, GzipBytes):
        return f"{value:d}gz"
    # A mask or a drawing.
    return {"name": value.name, "sha256": value.sha256} if hasattr(value, "sha256") else value


def names_for_library() -> set[str]:
    """The options that decide a result, by the names under which the library takes them."""
    own = {each.name for each, spec in settings_of(Request) if spec.decides}
    artwork = {each.name for each, _ in settings_of(ArtworkSettings)}
    # The library is given one picture.
    return (own | artwork | FitSettings.names() | {"measure"}) - {"frame"}


def request_of(options: Mapping[str, Any]) -> Request:
    """The request for options by name, of the command or of the library; None means the default.

    weights: any picture, or its path. init: the path or the bytes of an SVG, or an earlier result. Raises UsageError
    for values that make no sense, and InputError for a mask or a drawing that cannot be read.
    """
    given = {name: value for name, value in renamed(options).items() if value is not None}
    artwork = {each.name: given.pop(each.name) for each, _ in settings_of(ArtworkSettings) if each.name in given}
    fit = {name: given.pop(name) for name in FitSettings.names() if name in given}
    for each, spec in settings_of(Request):
        if spec.parse is not None and each.name in given:
            given[each.name] = spec.parse(given[each.name])
    if given.get("gap_filler"):
        given.setdefault("overlap", 1.0)
    if given.get("layers") is not None or given.get("overlap") is not None:
        artwork["stacking"] = CUTOUT
    # Measured at equal bytes (docs/lab/photos.md): closed curves of 2 segments have some 0.2 dB more than of 4.
    if "max_bytes" in given and fit.get("mode", "closed") == "closed" and given.get("style") != "artwork":
        if isinstance(given["max_bytes"], GzipBytes) and given["max_bytes"] < TINY_BYTES:
            _prefer_polygons(fit)
        elif fit.get("shapes", ANY) == ANY:
            fit.setdefault("segments", 2)
    settings, drawing = FitSettings.from_preset(**fit), ArtworkSettings(**artwork)
    if "weights" in given:
        from cubicsplat_cli.files.weights import load_mask

        given["weights"] = load_mask(given["weights"], max_pixels=given.get("max_pixels", MAX_PIXELS))
    if "init" in given:
        from cubicsplat_cli.svg.initial import load_initial_drawing

        svg = getattr(given["init"], "svg", None)
        given["init"] = load_initial_drawing(given["init"] if svg is None else svg.encode(), settings.mode)
    return Request(settings, drawing, **given)


def _prefer_polygons(fit: dict[str, Any]) -> None:
    """Makes a fit one of polygons for a coarse grid, of 4 vertices at first, unless other options say what it is."""
    if fit.get("shapes", ANY) == ANY and fit.get("fill", "flat") == "flat":
        fit["shapes"] = "polygon"
    if fit.get("preset", "standard") == "standard":
        fit.setdefault("steps", TINY_STEPS)
    if fit.get("shapes", ANY) in (ANY, "polygon"):
        fit.setdefault("segments", 4)
