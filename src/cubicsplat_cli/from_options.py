"""Requests from options by name, as the command and the library take them. Imports nothing heavy."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from cubicsplat_cli.artwork.settings import CUTOUT, ArtworkSettings
from cubicsplat_cli.clip_request import FIT_SETTINGS, ClipRequest
from cubicsplat_cli.options import RENAMED, TINY_BYTES, GzipBytes, renamed, settings_of, unknown_setting
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import ANY, MAX_PIXELS, FitSettings


def check_library_names(owner: type[Request] | type[ClipRequest], options: Mapping[str, Any]) -> None:
    """Raise UsageError for an option of a request that the library does not take: it decides no result."""
    names = {each.name for each, spec in settings_of(owner) if spec.decides} | {"title", "on_progress"}
    if owner is Request:
        # The library is given one picture, of which nobody chooses a frame.
        names |= {each.name for each, _ in settings_of(ArtworkSettings)} | FitSettings.names() | {"measure"}
        names -= {"frame"}
    else:
        names = (names | {*FIT_SETTINGS}) - {"format"}
    for name in options:
        if RENAMED.get(name, name) not in names:
            raise unknown_setting(name, names)


def request_of(options: Mapping[str, Any]) -> Request:
    """Return the request for options by name; None means the default.

    weights: any picture, or its path. init: the path or the bytes of an SVG, or an earlier result. Raises UsageError
    for values that make no sense, and InputError for a mask or a drawing that cannot be read.
    """
    given = _given(Request, options)
    artwork = {each.name: given.pop(each.name) for each, _ in settings_of(ArtworkSettings) if each.name in given}
    fit = {name: given.pop(name) for name in FitSettings.names() if name in given}
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


def clip_request_of(options: Mapping[str, Any]) -> ClipRequest:
    """Return the request for options by name; None means the default. Raises UsageError for senseless values."""
    given = _given(ClipRequest, options)
    fit = {name: given.pop(name) for name in FIT_SETTINGS if name in given}
    return ClipRequest(FitSettings.from_preset(**fit), **given)


def _given(owner: type[Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options that are not None, under their present names, those of the owner parsed."""
    given = renamed(options)
    for each, spec in settings_of(owner):
        if spec.parse is not None and each.name in given:
            given[each.name] = spec.parse(given[each.name])
    return given


def _prefer_polygons(fit: dict[str, Any]) -> None:
    """Prefer polygons of 4 vertices, for a coarse grid, where the other options of a fit leave that open."""
    if fit.get("shapes", ANY) == ANY and fit.get("fill", "flat") == "flat":
        fit["shapes"] = "polygon"
    if fit.get("preset", "standard") == "standard":
        fit.setdefault("steps", 1200)
    if fit.get("shapes", ANY) in (ANY, "polygon"):
        fit.setdefault("segments", 4)
