"""The measures of pictures that can be asked for, by name. Imports nothing heavy: the command line checks with it."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass

from cubicsplat_cli.errors import UsageError

USUAL = ("psnr", "ssim")


@dataclass(frozen=True)
class Measure:
    """label: of the figure in text. member: its name in reports. decimals: of the text. worse: which of two is."""

    label: str
    member: str
    decimals: int
    worse: Callable[[list[float]], float]


FURTHER = {
    "ms-ssim": Measure("MS-SSIM", "ms_ssim", 4, min),
    "lpips": Measure("LPIPS", "lpips", 4, max),
    "de00": Measure("dE00", "de00", 3, max),
}
NAMES = (*USUAL, *FURTHER)


def chosen_measures(text: str) -> tuple[str, ...]:
    """The measures of a list with commas, each once. Raises UsageError for a name that is none, or for no name."""
    names = tuple(dict.fromkeys(part.strip().lower() for part in text.split(",") if part.strip()))
    if not names or not set(names) <= set(NAMES):
        raise UsageError(f"must be of {', '.join(NAMES)}, with commas between them, not {text!r}", "measures")
    return names


def figures_text(figures: Mapping[str, float | None]) -> Iterator[str]:
    """`LPIPS 0.1234`, `MS-SSIM n/a`, ..."""
    for measure in FURTHER.values():
        if measure.member in figures:
            value = figures[measure.member]
            yield f"{measure.label} {'n/a' if value is None else f'{value:.{measure.decimals}f}'}"
