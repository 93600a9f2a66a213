"""One candidate, an SVG or a picture, compared with its reference: what `cubicsplat eval` reports."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field
from typing import Any

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.images import downsampled_scene, downsampled_svg
from cubicsplat_cli.evaluate.metrics import compare, compare_premultiplied
from cubicsplat_cli.evaluate.perceptual import further, straight_rgba
from cubicsplat_cli.evaluate.rerender import Rendered, rerender_untrusted
from cubicsplat_cli.files.load import Picture, load_picture
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.metrics import Input, Quality, gap_db
from cubicsplat_cli.record import record
from cubicsplat_cli.settings import MAX_PIXELS, SCALE

# Half a percent: what rounding to whole pixels does to a small picture's shape is no mistake of the user.
_ASPECT_TOLERANCE = 0.005
# Edges per cubic of the engine's picture at its native size (S* of the exact finish).
ENGINE_SAMPLES = 48


@record
class Change:
    """One renderer's quality at native size and after drawing several times as large and averaging back."""

    native: Quality
    scaled: Quality

    @property
    def change_db(self) -> float | None:
        """Scaled minus native PSNR; None when either picture is identical to the reference."""
        return gap_db(self.native, self.scaled)

    def public(self) -> dict[str, Any]:
        return {"native": self.native, "scaled": self.scaled, "change_db": self.change_db}


@record
class ScaleFigures:
    """Scale consistency: of the file, and of the engine where the file is one of ours (else None)."""

    factor: int
    file: Change
    engine: Change | None


@record
class ComparedFile:
    """The file that is compared with the reference. renderer: draws it if it is an SVG, None for a picture."""

    path: str
    data: bytes
    renderer: str | None

    @property
    def kind(self) -> str:
        return "raster" if self.renderer is None else "svg"


@record
class Comparison:
    """A candidate, its reference, and the metrics of the two."""

    reference: Picture
    reference_path: str
    candidate: ComparedFile
    quality: Quality
    scale: ScaleFigures | None = None
    notes: list[str] = field(default_factory=list)
    measures: dict[str, float | None] = field(default_factory=dict)  # further ones, by their names in reports

    def public(self) -> dict[str, Any]:
        """The members of the JSON report that are about this pair, for `report.plain`."""
        picture, candidate = self.reference, self.candidate
        members: dict[str, Any] = {
            "reference": Input(
                self.reference_path, picture.sha256, picture.width, picture.height, picture.alpha is not None
            ),
            "candidate": {
                "path": candidate.path,
                "sha256": sha256_of(candidate.data),
                "kind": candidate.kind,
                "bytes": len(candidate.data),
            },
            "quality": {"renderer": candidate.renderer, **vars(self.quality)},
        }
        if self.measures:
            members["measures"] = self.measures
        if self.scale is not None:
            members["scale"] = self._scale_fields(self.scale)
        return members | {"notes": list(self.notes)}

    def _scale_fields(self, scale: ScaleFigures) -> dict[str, Any]:
        return {
            "factor": scale.factor,
            "width": self.reference.width * scale.factor,
            "height": self.reference.height * scale.factor,
            "svg": scale.file.public(),
            "engine": None if scale.engine is None else scale.engine.public(),
        }


def compare_with(
    reference: Picture,
    reference_path: str,
    data: bytes,
    candidate_path: str,
    *,
    is_svg: bool,
    renderer: str = "auto",
    max_pixels: int = MAX_PIXELS,
    scale: int | None = None,
    threads: int | None = None,
    measures: Sequence[str] = (),
) -> Comparison:
    """Compare the bytes of an SVG (drawn at the reference's size) or of a picture with the reference.

    scale: 1..12, for an SVG: also draw it that many times as large. measures: further ones (`further`). Raises
    InputError for a candidate that cannot be used, UsageError for a senseless scale or one asked of a picture,
    EngineError where no renderer works, or what a measure needs is missing.
    """
    notes = [f"{reference.source}: {note}" for note in reference.notes]
    if scale is not None:
        SCALE.check("scale", scale)
    if not is_svg:
        if scale is not None:
            raise UsageError(f"{candidate_path}: is a picture; --scale is about SVG files")
        picture = load_picture(data, name=candidate_path, max_pixels=max_pixels, smaller="compare smaller copies")
        notes.extend(f"{picture.source}: {note}" for note in picture.notes)
        quality = compare_premultiplied(reference, picture.target())
        further_figures = further(reference, straight_rgba(picture), measures) if measures else {}
        candidate = ComparedFile(candidate_path, data, None)
        return Comparison(reference, reference_path, candidate, quality, notes=notes, measures=further_figures)
    drawn = _draw_svg(reference, data, candidate_path, renderer, notes)
    quality, further_figures = compare(reference, drawn.pixels), further(reference, drawn.pixels, measures)
    figures = None
    if scale is not None:
        large = downsampled_svg(
            data, reference.width, reference.height, scale, source=candidate_path, renderer=renderer
        )
        file = Change(quality, compare_premultiplied(reference, large.pixels))
        figures = ScaleFigures(scale, file, _engine(reference, data, candidate_path, scale, threads, notes))
    candidate = ComparedFile(candidate_path, data, drawn.renderer)
    return Comparison(reference, reference_path, candidate, quality, figures, notes, further_figures)


def _draw_svg(reference: Picture, data: bytes, source: str, renderer: str, notes: list[str]) -> Rendered:
    """An SVG drawn at the reference's size; may add to `notes`."""
    rendered, size = rerender_untrusted(
        data, source=source, width=reference.width, height=reference.height, renderer=renderer
    )
    if abs(size.width * reference.height / (size.height * reference.width) - 1.0) > _ASPECT_TOLERANCE:
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
    """The engine's figures where the file is one of ours at the reference's size; else None and a note."""
    from cubicsplat_cli.svg.scene_reader import read_svg

    try:
        scene = read_svg(data)
    except InputError as error:
        notes.append(f"{source}: no figures of the engine: {error}")
        return None
    if (scene.width, scene.height) != (reference.width, reference.height):
        notes.append(f"{source}: no figures of the engine, because its size is not that of the reference")
        return None
    qualities = (
        compare_premultiplied(reference, downsampled_scene(scene, factor, samples=ENGINE_SAMPLES, threads=threads))
        for factor in (1, scale)
    )
    return Change(*qualities)
