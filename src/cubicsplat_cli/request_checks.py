"""The options of a request that do not go together."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from cubicsplat_cli.artwork.settings import CUTOUT
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.paths import MOVING
from cubicsplat_cli.options import IMAGE, NO_SHADING, OBJECT, TINY_BYTES, length_of
from cubicsplat_cli.settings import ANY, Mode

if TYPE_CHECKING:
    from cubicsplat_cli.request import Request


def check_request(request: Request) -> None:
    """Raise UsageError, naming an option, where it does not go with another, or its value makes no sense."""
    if request.style in ("artwork", "pixel") and request.of_photos():
        raise UsageError(
            f"is for photos, not for {request.style}; leave it out, or use style photo", request.of_photos()[0]
        )
    if request.style == "pixel":
        _check_pixels(request)
    if request.style == "photo" and request.of_artwork():
        raise UsageError("is for artwork, not for photos; leave it out, or use style artwork", request.of_artwork()[0])
    if request.of_photos() and request.of_artwork():
        other = request.of_photos()[0].replace("_", "-")
        raise UsageError(f"is for artwork, --{other} for photos; give one of them", request.of_artwork()[0])
    if request.shading != NO_SHADING and not request.may_shade:
        raise UsageError(
            "is of drawings as they are; leave out options of colours, groups, cutouts, strokes, bytes, movies",
            "shading",
        )
    if request.photo_parts == IMAGE and not request.may_hold_photos:
        raise UsageError(
            "image is of drawings as they are; leave out options of photos, pixels, colours, groups, cutouts, "
            "strokes, bytes, time, movies",
            "photo_parts",
        )
    if request.artwork.stacking == CUTOUT and request.strokes:
        option = "--strokes" if request.artwork.strokes else "--mode open"
        asked = next((name for name in ("layers", "gap_filler", "overlap") if getattr(request, name)), "")
        said = "is of cutouts, which have" if asked else "cutout has"
        raise UsageError(f"{said} shapes only; leave out {option}, which is for strokes", asked or "stacking")
    _check_structure(request)
    if request.freeze and request.init is None:
        raise UsageError("needs a drawing whose curves stay as they are; give it with --init", "freeze")
    if request.init is not None and request.settings.shapes != ANY:
        raise UsageError("are for new curves, not for those of a drawing; leave out --init", "shapes")
    budgets = [name for name in ("max_bytes", "max_nodes", "target_psnr") if getattr(request, name) is not None]
    if len(budgets) > 1:
        raise UsageError(f"and --{budgets[1].replace('_', '-')} are two budgets; give one of them", budgets[0])
    if budgets and (request.freeze or request.init is not None or request.settings.curves is not None):
        raise UsageError("finds the number of curves itself; leave out --curves, --init and --freeze", budgets[0])
    if request.tiny:
        _check_tiny(request)
    if request.animation is not None and request.animation.suffix.lower() not in MOVING:
        raise UsageError(f"must end in {' or '.join(MOVING)}, not {str(request.animation)!r}", "animation")
    if set(request.suffix) & set("/\\\0"):
        raise UsageError(f"must be the end of a file's name, not {request.suffix!r}", "suffix")
    if request.geometrize is not None:
        _check_geometrize(request.geometrize, request)
    if request.data_uri and request.compress:
        raise UsageError("--svgz is for files; a data: URI holds text, so leave one of them out", "data_uri")
    if request.force and request.skip_existing:
        raise UsageError("--force makes anew what --skip-existing leaves alone; give one of them")


def _check_pixels(request: Request) -> None:
    """Raise UsageError for what pixel art cannot have."""
    if request.artwork.min_area:
        raise UsageError("joins small regions, which pixel art keeps; use style artwork, or leave it out", "min_area")
    if request.artwork.strokes:
        raise UsageError("are what pixel art has none of; leave it out", "strokes")
    if request.settings.mode is Mode.OPEN:
        raise UsageError("open is for strokes, which pixel art has none of; leave it out", "mode")
    if request.max_bytes is not None or request.target_psnr is not None:
        raise UsageError(
            "leaves details out, which pixel art keeps; use style artwork, or leave it out",
            "target_psnr" if request.max_bytes is None else "max_bytes",
        )
    if request.group_by == OBJECT:
        raise UsageError("object is of shapes, but pixel art has one path a colour; use color", "group_by")


def _check_structure(request: Request) -> None:
    if request.layers is not None and request.group_by == OBJECT:
        raise UsageError("has a file for each colour; leave out --group-by object", "layers")
    if request.overlap is not None and request.group_by == OBJECT:
        asked = "gap_filler" if request.gap_filler else "overlap"
        raise UsageError("is drawn colour by colour; leave out --group-by object", asked)
    unit = "" if request.width is None else length_of(request.width)[1]
    if unit and request.units not in ("px", unit):
        raise UsageError(f"{request.width} says its own unit; leave out --units {request.units}", "width")


def _check_geometrize(path: Path, request: Request) -> None:
    """Raise UsageError where there are no shapes that Geometrize has, or the file is no JSON."""
    if request.settings.shapes not in ("ellipse", "rectangle", "triangle") or request.tiny:
        raise UsageError("has ellipses, rectangles and triangles; choose one of them with --shapes", "geometrize")
    if path.suffix.lower() != ".json":
        raise UsageError(f"must end in .json, not {str(path)!r}", "geometrize")


def _check_tiny(request: Request) -> None:
    """Raise UsageError for what a file without a size, and polygons on a coarse grid, cannot have."""
    fit, said = request.settings, "writes no size"
    wrong = {"width": request.width is not None, "units": request.units != "px"}
    if request.style != "artwork" and not any(wrong.values()):
        said = "writes photos as polygons on a coarse grid"
        wrong = {
            "mode": fit.mode is Mode.OPEN, "fill": fit.fill != "flat", "precision": request.precision is not None,
            "shapes": fit.shapes in ("ellipse", "rectangle"), "loss": fit.loss != "l2",
        }  # fmt: skip
    for name in (name for name, is_wrong in wrong.items() if is_wrong):
        raise UsageError(
            f"does not go with --max-bytes below {TINY_BYTES // 1000}kgz, which {said}; leave it out, or allow "
            "more bytes",
            name,
        )
