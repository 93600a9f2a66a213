"""The metrics JSON, schema 1: what `OUT.json` and `--json` hold. Described in docs/metrics-json.md."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from cubicsplat_cli.evaluate.metrics import Quality
from cubicsplat_cli.files.load import Picture

SCHEMA = 1
# Decimals of the measured figures; more would only suggest a precision that no measure has.
_DECIMALS = {"psnr_db": 4, "ssim": 5, "agreement_db": 4, "gap_db": 4, "change_db": 4}


@dataclass(frozen=True)
class OutputFiles:
    """What was written: paths as text (None: not written, or standard output), `bytes` and `paths` of the
    SVG.
    """

    svg: str | None
    png: str | None
    svg_bytes: int
    paths: int


@dataclass(frozen=True)
class Timing:
    """Wall-clock seconds: everything, the fit alone, its steps, and milliseconds of one step."""

    total_s: float
    fit_s: float
    steps: int
    ms_per_step: float


def input_fields(picture: Picture, path: str) -> dict[str, Any]:
    """Which picture it was; `path` as the user named it."""
    return {
        "path": path,
        "sha256": picture.sha256,
        "width": picture.width,
        "height": picture.height,
        "alpha": picture.alpha is not None,
    }


def quality_fields(quality: Quality) -> dict[str, Any]:
    """psnr_db, ssim and identical of one comparison, and why SSIM is null where it is."""
    fields: dict[str, Any] = {
        "psnr_db": rounded("psnr_db", quality.psnr_db),
        "ssim": rounded("ssim", quality.ssim),
        "identical": quality.identical,
    }
    if quality.ssim_note is not None:
        fields["ssim_note"] = quality.ssim_note
    return fields


def gap_db(svg: Quality, surrogate: Quality) -> float | None:
    """PSNR of the own picture minus PSNR of the SVG, dB; None when either is identical to the reference."""
    if svg.psnr_db is None or surrogate.psnr_db is None:
        return None
    return surrogate.psnr_db - svg.psnr_db


def build_report(
    *,
    version: str,
    picture: Picture,
    path: str,
    output: OutputFiles,
    settings: Mapping[str, Any],
    device: Mapping[str, Any],
    timing: Timing,
    svg_quality: Quality,
    renderer: str,
    surrogate: Quality,
    surrogate_samples: int,
    agreement_db: float | None,
    history: Sequence[Mapping[str, Any]],
    replaced: int,
    dropped: int | None = None,
    interrupted: bool,
    notes: Sequence[str],
) -> dict[str, Any]:
    """The report of one vectorised picture as plain JSON values (schema 1).

    agreement_db: `metrics.agreement_db` of the own picture and the drawn SVG; None where no value differs. replaced,
    dropped: curves seeded anew during the fit, and left out at its end (None: not known).
    """
    return {
        "schema": SCHEMA,
        "program": "cubicsplat",
        "version": version,
        "input": input_fields(picture, path),
        "output": {"svg": output.svg, "png": output.png, "bytes": output.svg_bytes, "paths": output.paths},
        "settings": dict(settings),
        "device": dict(device),
        "timing": {
            "total_s": round(timing.total_s, 3),
            "fit_s": round(timing.fit_s, 3),
            "steps": timing.steps,
            "ms_per_step": round(timing.ms_per_step, 4),
        },
        "quality": {
            "svg": {"renderer": renderer, **quality_fields(svg_quality)},
            "surrogate": {"samples": surrogate_samples, **quality_fields(surrogate)},
            "agreement_db": rounded("agreement_db", agreement_db),
            "gap_db": rounded("gap_db", gap_db(svg_quality, surrogate)),
        },
        "replaced": replaced,
        "dropped": dropped,
        "interrupted": interrupted,
        "notes": list(notes),
        "history": [dict(entry) for entry in history],
    }


def to_json(report: Mapping[str, Any]) -> str:
    """Strictly valid JSON text, ending with a newline; numbers that are not finite become null."""
    return json.dumps(_finite(report), indent=2, allow_nan=False, ensure_ascii=True) + "\n"


def rounded(name: str, value: float | None) -> float | None:
    """A figure cut to the decimals its kind is reported with."""
    return None if value is None else round(value, _DECIMALS[name])


def _finite(value: Any) -> Any:
    """`value` with plain containers, and None for every float that JSON has no number for."""
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_finite(item) for item in value]
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else None
    return value
