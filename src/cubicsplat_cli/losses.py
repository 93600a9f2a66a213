"""What the fit of a photo minimises, as the user names it. Imports nothing heavy."""

from __future__ import annotations

import math

from cubicsplat_cli.errors import UsageError

LOSSES = ("l2", "l1", "huber", "ms-ssim")
_FORM = "must be l2, l1, huber or ms-ssim, or a mixture by weight such as l2:0.7,ms-ssim:0.3"


def parse_loss(text: str) -> dict[str, float]:
    """Weights, above 0, by name, in the order of `LOSSES`. Raises UsageError for anything that is no such mixture."""
    found: dict[str, float] = {}
    for part in text.lower().split(",") if isinstance(text, str) else ():
        name, given, weight = part.partition(":")
        name = name.strip()
        try:
            found[name] = float(weight) if given else 1.0 if name not in found else math.nan
        except ValueError:
            found[name] = math.nan
    if not found or not set(found) <= set(LOSSES) or not all(0.0 < w < 1e6 for w in found.values()):
        raise UsageError(f"{_FORM}, not {text!r}", "loss")
    if "l1" in found and "huber" in found:
        raise UsageError(f"takes l1 or huber, not both, since both are linear for large errors: {text!r}", "loss")
    return {name: found[name] for name in LOSSES if name in found}


def loss_text(weights: dict[str, float]) -> str:
    """The shortest text of a mixture: two texts of one mean the same."""
    if len(weights) == 1:
        return next(iter(weights))
    total = sum(weights.values())
    return ",".join(f"{name}:{weight / total:.6g}" for name, weight in weights.items())
