"""Compare a candidate, an SVG or a picture, with its reference: the figures of `cubicsplat eval`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Any

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.images import downsampled_scene, downsampled_svg, of_pixels, of_values
from cubicsplat_cli.evaluate.metrics import compare
from cubicsplat_cli.evaluate.perceptual import further, straight_rgba
from cubicsplat_cli.evaluate.rerender import Rendered, rerender_untrusted
from cubicsplat_cli.files.load import Picture, load_picture
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.metrics import Input, Quality, gap_db
from cubicsplat_cli.record import record
from cubicsplat_cli.settings import MAX_PIXELS


@record
class Change:
    """A renderer's quality at native size, and several times as large, averaged back. change_db: the scaled minus the
    native PSNR; None if either picture is identical to the reference.
    """

    native: Quality
    scaled: Quality
    change_db: float | None


@record
class ScaleFigures:
    """Scale consistency of an SVG and, if it is one of ours, of the engine. width, height: scaled, px."""

    factor: int
    width: int
    height: int
    svg: Change
    engine: Change | None


@record
class Comparison:
    """A candidate, its reference, and the metrics of the two. path, data: of the candidate. renderer: the one that
    drew an SVG; None for a picture.
    """

    reference: Picture
    reference_path: str
    path: str
    data: bytes
    renderer: str | None
    quality: Quality
    scale: ScaleFigures | None = None
    notes: list[str] = field(default_factory=list)
    measures: dict[str, float | None] = field(default_factory=dict)  # further metrics, by their names in reports

    @property
    def kind(self) -> str:
        return "raster" if self.renderer is None else "svg"

    def public(self) -> dict[str, Any]:
        """Return the members of the JSON report on this pair, for `metrics.plain`."""
        picture, data = self.reference, self.data
        members: dict[str, Any] = {
            "reference": Input(
                self.reference_path, picture.sha256, picture.width, picture.height, picture.alpha is not None
            ),
            "candidate": {"path": self.path, "sha256": sha256_of(data), "kind": self.kind, "bytes": len(data)},
            "quality": {"renderer": self.renderer, **vars(self.quality)},
        }
        if self.measures:
            members["measures"] = self.measures
        if self.scale is not None:
            members["scale"] = self.scale
        return members | {"notes": list(self.notes)}


def compare_with(
    reference: Picture, reference_path: str, data: bytes, candidate_path: str, *, is_svg: bool, renderer: str = "auto",
    max_pixels: int = MAX_PIXELS, scale: int | None = None, threads: int | None = None, measures: Sequence[str] = (),
) -> Comparison:  # fmt: skip
    """Compare the bytes of an SVG (drawn at the reference's size) or of a picture with the reference.

    scale: 1..12, for an SVG: also draw it that many times as large. measures: names of further metrics (`further`).
    Raises InputError for an unusable candidate, UsageError for a senseless scale or a picture with a scale, EngineError
    if no renderer works, or a metric misses a package.
    """
    notes = [f"{reference.source}: {note}" for note in reference.notes]
    if scale is not None and not is_svg:
        raise UsageError(f"{candidate_path}: is a picture; --scale is about SVG files")
    drawn_by, figures = None, None
    if is_svg:
        drawn = _draw_svg(reference, data, candidate_path, renderer, notes)
        pixels, drawn_by, quality = drawn.pixels, drawn.renderer, compare(reference, of_pixels(drawn.pixels))
    else:
        picture = load_picture(data, name=candidate_path, max_pixels=max_pixels, smaller="compare smaller copies")
        notes.extend(f"{picture.source}: {note}" for note in picture.notes)
        pixels, quality = straight_rgba(picture), compare(reference, of_values(picture.target()))
    further_figures = further(reference, pixels, measures)
    if scale is not None:
        size = reference.width, reference.height
        large = downsampled_svg(data, *size, scale, source=candidate_path, renderer=renderer)
        change = _change(quality, compare(reference, of_values(large.pixels)))
        engine = _engine(reference, data, candidate_path, scale, threads, notes)
        figures = ScaleFigures(scale, scale * reference.width, scale * reference.height, change, engine)
    return Comparison(
        reference, reference_path, candidate_path, data, drawn_by, quality, figures, notes, further_figures
    )


def _draw_svg(reference: Picture, data: bytes, source: str, renderer: str, notes: list[str]) -> Rendered:
    """Draw an SVG at the reference's size; may add to `notes`."""
    rendered, size = rerender_untrusted(
        data, source=source, width=reference.width, height=reference.height, renderer=renderer
    )
    # Half a percent: the rounding of a small picture's sides to whole pixels is no mistake of the user.
    if abs(size.width * reference.height / (size.height * reference.width) - 1.0) > 0.005:
        notes.append(
            f"{source}: its shape, {size.width:g} x {size.height:g}, is not that of the reference, "
            f"{reference.width} x {reference.height}; it is centred and leaves borders"
        )
    if rendered.note is not None:
        notes.append(rendered.note)
    return rendered


def _engine(
    reference: Picture, data: bytes, source: str, scale: int, threads: int | None, notes: list[str]
) -> Change | None:
    """Return the engine's figures if the file is one of ours at the reference's size; else None and a note."""
    from cubicsplat_cli.svg.scene_reader import read_svg

    try:
        scene = read_svg(data)
    except InputError as error:
        notes.append(f"{source}: no figures of the engine: {error}")
        return None
    if (scene.width, scene.height) != (reference.width, reference.height):
        notes.append(f"{source}: no figures of the engine, because its size is not that of the reference")
        return None
    # At its native size the engine's picture has as many edges per cubic as in the exact finish.
    pictures = (downsampled_scene(scene, factor, samples=48, threads=threads) for factor in (1, scale))
    return _change(*(compare(reference, of_values(picture)) for picture in pictures))


def _change(native: Quality, scaled: Quality) -> Change:
    return Change(native, scaled, gap_db(native, scaled))
