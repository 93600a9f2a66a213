"""Metamorphic pairs: a drawing and the same drawing in a way that must not matter, vectorized and compared."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np

from benchmarks import main
from benchmarks.artwork.degradations import jpeg, lay_over_white
from benchmarks.artwork.document import SIZE, Document, Drawings, Only, Size, Skip, drawings_in
from benchmarks.artwork.pixels import evenly_coloured, srgb_of_light
from benchmarks.artwork.scores import count
from benchmarks.tools import TOOLS, Given, pixels_of
from cubicsplat_cli.artwork.channels import light_of_srgb
from cubicsplat_cli.cli.bench import Limit, Markdown, check_limit, comma_parts, end_with, print_report
from cubicsplat_cli.cli.console import Reporter
from cubicsplat_cli.cli.options import Json, Quiet, option
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.evaluate.perceptual import mean_delta_e
from cubicsplat_cli.formatting import number, one_line, text_table
from cubicsplat_cli.metrics import head

SHAPES = 0.10  # share by which the number of shapes may differ
DELTA_E, ROUGH_DELTA_E = 0.05, 0.25  # by which the difference to the truth may differ; of aliased and JPEG pictures
CROP, MARGIN = (3, 5), 0.25  # px from the left and the top; share of the longer side, on each side
FINE = 16  # samples along each side of a pixel
_STRIP = 64  # px, rows that are drawn finely at a time

_LEVELS = np.arange(256, dtype=np.float32) / 255
_LINEAR = light_of_srgb(_LEVELS).astype(np.float32)


def _with_margin(pixels: np.ndarray, scale: int) -> np.ndarray:
    border = scale * round(MARGIN * max(pixels.shape[:2]) / scale)
    return np.pad(pixels, ((border, border), (border, border), (0, 0)), constant_values=255)


def _cropped(pixels: np.ndarray, scale: int) -> np.ndarray:
    return pixels[scale * CROP[1] :, scale * CROP[0] :]


def _with_colours(change: Callable[[np.ndarray], np.ndarray], pixels: np.ndarray, _scale: int) -> np.ndarray:
    return np.dstack([change(pixels[..., :3]), pixels[..., 3]])


def _finely(document: Document, *, linear: bool) -> np.ndarray:
    """Drawn from 16 x 16 samples a pixel, averaged as sRGB values or in linear light."""
    strips = []
    for top in range(0, document.height, _STRIP):
        rows, values = min(_STRIP, document.height - top), _LINEAR if linear else _LEVELS
        fine = document.draw(FINE, window=(0, top, document.width, rows), smooth=False)[..., :3]
        strips.append(values[fine].reshape(rows, FINE, document.width, FINE, 3).mean(axis=(1, 3)))
    mean = np.concatenate(strips)
    if linear:
        mean = srgb_of_light(mean)
    return np.dstack([np.rint(255 * mean).astype(np.uint8), np.full(mean.shape[:2], 255, np.uint8)])


@dataclass(frozen=True)
class Variation:
    """draw: the input of a document. change: of pixels (H, W, 4), at so many times the input's size, of input and truth
    alike; of no files. tolerance: by which the difference to the truth may differ from the plain drawing's. renderer:
    of the truth, which some gradients are not the same in.
    """

    draw: Callable[[Document], Given] = Document.draw
    change: Callable[[np.ndarray, int], np.ndarray] = lambda pixels, _scale: pixels
    tolerance: float = DELTA_E
    renderer: str = "resvg"


PLAIN = Variation()
VARIATIONS = {
    "margin": Variation(change=_with_margin),
    "crop": Variation(change=_cropped),
    "flip": Variation(change=lambda pixels, _: pixels[:, ::-1]),
    "turn": Variation(change=lambda pixels, _: np.rot90(pixels)),
    "hue": Variation(change=partial(_with_colours, lambda colours: np.roll(colours, 1, axis=2))),
    "inverted": Variation(change=partial(_with_colours, lambda colours: 255 - colours)),
    "level": Variation(change=partial(_with_colours, lambda colours: np.minimum(colours, 254) + 1)),
    "cairo": Variation(partial(Document.draw, renderer="cairosvg"), renderer="cairosvg"),
    "area": Variation(partial(_finely, linear=False)),
    "linear": Variation(partial(_finely, linear=True)),
    "larger": Variation(partial(Document.draw, scale=1.5)),
    "aliased": Variation(partial(Document.draw, smooth=False), tolerance=ROUGH_DELTA_E),
    **{f"jpeg{q}": Variation(partial(jpeg, quality=q), tolerance=ROUGH_DELTA_E) for q in (70, 80, 90, 95)},
}


@dataclass(frozen=True)
class Pair:
    """A variation of a drawing beside the plain one: its shapes, and mean CIEDE2000 to the truth at twice the size.
    untold: that of the even colours of its input, which tell no more.
    """

    drawing: str
    way: str
    shapes: int
    delta_e: float
    untold: float
    plain_shapes: int
    plain_delta_e: float

    @property
    def agrees(self) -> bool:
        """Whether the variation made no difference."""
        few = abs(self.shapes - self.plain_shapes) <= SHAPES * self.plain_shapes
        off, tolerance = self.delta_e - self.plain_delta_e, VARIATIONS[self.way].tolerance
        return few and -tolerance <= off <= tolerance + self.untold


def scored(document: Document, variation: Variation) -> tuple[int, float, float]:
    """Shapes of the vectorized drawing, CIEDE2000 to the truth, over the pixels of the drawing without a margin, and
    that of the input's even colours.
    """
    given, untold = variation.draw(document), 0.0
    if isinstance(given, np.ndarray):
        given = np.ascontiguousarray(variation.change(given, 1))
    else:
        untold = even_delta_e(document.draw(), pixels_of(given))
    truth = np.ascontiguousarray(variation.change(document.draw(2, renderer=variation.renderer), 2))
    made = Document(TOOLS["ours"](given), "the result", max(truth.shape[:2]) // 2)
    # A margin, where nothing is drawn, makes the mean as much smaller as it makes the picture larger.
    share = truth.shape[0] * truth.shape[1] / (4 * document.width * document.height)
    return count(made).shapes, share * mean_delta_e(truth, made.draw(2)), untold


def even_delta_e(plain: np.ndarray, seen: np.ndarray) -> float:
    """Mean CIEDE2000 of a picture (H, W, 4) uint8 and the same with each colour, where it is even, in the mean that it
    has in another such picture.
    """
    even = evenly_coloured(plain)
    _, index, counts = np.unique(plain[even], axis=0, return_inverse=True, return_counts=True)
    index, told = index.reshape(-1), plain.copy()
    means = np.stack([np.bincount(index, channel) for channel in seen[even].T.astype(float)], axis=1) / counts[:, None]
    told[even] = np.rint(means)[index]
    return mean_delta_e(plain, told)


def pairs_of(path: Path, ways: Sequence[str], size: int, failed: list[tuple[str, str, str]]) -> Iterator[Pair]:
    """The pairs of one drawing, whose longer side has `size` px; failures are added to `failed`."""
    document = Document(path.read_bytes(), path.stem, size)
    # Even sides stay whole when they are made larger by half.
    document.width, document.height = (max(2, side - side % 2) for side in (document.width, document.height))
    lay_over_white(document)
    plain: tuple[int, float, float] | None = None
    for name in ("plain", *ways):
        try:
            figures = scored(document, VARIATIONS.get(name, PLAIN))
        except Exception as error:
            # Whatever it raises, a way that fails does not agree.
            failed.append((path.stem, name, one_line(error) or type(error).__name__))
            if plain is None:
                return
            continue
        if plain is None:
            plain = figures
        else:
            yield Pair(path.stem, name, *figures, *plain[:2])


def table_of(
    pairs: Sequence[Pair], failed: Sequence[tuple[str, str, str]], ways: Sequence[str], *, markdown: bool
) -> str:
    """A row per drawing and way, one per way with the number that agree, and one of all; failures do not agree."""
    rows = [
        (
            f"{p.drawing}, {p.way}", str(p.plain_shapes), str(p.shapes), number(p.plain_delta_e, 3),
            number(p.delta_e, 3), "agrees" if p.agrees else "differs",
        )
        for p in pairs
    ]  # fmt: skip
    for name in (*ways, "all ways"):
        of = [pair.agrees for pair in pairs if name in (pair.way, "all ways")]
        of += [False for _, way, _ in failed if name in (way, "all ways")]
        rows.append((name, "", "", "", "", f"{sum(of)} of {len(of)}"))
    return text_table(("", "shapes", "this way", "dE00", "this way", ""), rows, markdown=markdown)


def metamorphic(
    folder: Drawings,
    ways: Annotated[str, option("--ways WAY,...", "Only these.")] = ",".join(VARIATIONS),
    size: Size = 512,
    only: Only = None,
    skip: Skip = None,
    limit: Limit = None,
    json: Json = False,
    markdown: Markdown = False,
    quiet: Quiet = False,
) -> None:
    """Drawings in ways that must not matter, and which of the results agree.

    A pair agrees where the shapes are within 10 % and the dE00 to the truth within 0.05 (aliased and JPEG: 0.25) of the
    plain drawing's; of a JPEG also by that of its even colours. All lie over white.
    """
    chosen = comma_parts(ways)
    if not chosen or not set(chosen) <= set(VARIATIONS):
        raise UsageError(f"--ways must be of {', '.join(VARIATIONS)}, with commas between them, not {ways!r}")
    SIZE.check("size", size)
    check_limit(limit)
    reporter = Reporter(quiet=quiet)
    pairs: list[Pair] = []
    failed: list[tuple[str, str, str]] = []
    for path in drawings_in(folder, only, skip, limit):
        for pair in pairs_of(path, chosen, size, failed):
            pairs.append(pair)
            reporter.summary(f"{pair.drawing}, {pair.way}: {'agrees' if pair.agrees else 'differs'}")
    report = {**head(), "bench": "metamorphic", "pairs": [asdict(p) | {"agrees": p.agrees} for p in pairs]}
    print_report(report, table_of(pairs, failed, chosen, markdown=markdown), json=json)
    end_with(failed)


if __name__ == "__main__":
    main(metamorphic)
