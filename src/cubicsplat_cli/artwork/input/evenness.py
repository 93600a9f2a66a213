"""Measure how even a picture is: neighbouring pixels of a drawing are alike, or an edge lies between them.

In a photo most neighbours differ a little. Means of blocks remove noise and JPEG artefacts. Small pictures have few
even areas, so there the differences of pixels a few px apart, past the blends on an edge, are measured. Differences in
a drawing are those of noise, or large and of any size; in a photo, larger ones are ever rarer. The likelihoods of both
models are compared.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import in_blocks, largest
from cubicsplat_cli.artwork.regions.fills import APART, FLAT_RANGE
from cubicsplat_cli.raster.unmix import steps
from cubicsplat_cli.record import record

SMALL = 64  # px of the longer side of a small picture; a larger one's blocks reduce it to about that
TILE = 16  # px of a tile's side; tiles of one even colour are ground, which does not count
ASIDE = 3  # px between the pixels of a pair, past an edge's blends
SAVED = 0.75  # nats a pair that noise and edges save in a drawing, at least


@record
class Evenness:
    """Shares of the pairs of neighbours that count: those that are alike, and those that differ a little."""

    alike: float
    little: float

    def __str__(self) -> str:
        return f"{100 * self.alike:.0f} % of neighbours alike, {100 * self.little:.0f} % a little off"


def even(levels: np.ndarray) -> tuple[bool, Evenness]:
    """Return True if a picture (H, W, C) in 0..255 of more than SMALL px is as even as drawings, and its evenness.
    Clear pixels count as one even colour.

    Of clean drawings of 128 px and more, at most 0.09 of the neighbours mostly differ a little; of photos 0.2 and more,
    and of their blocks 0.33 even if they are noisy, JPEGs or blurred. Dots for greys have less than half alike.
    """
    shorter, longer = sorted(levels.shape[:2])
    shares, side = evenness(levels, TILE), max(4, longer // SMALL)
    clean = _drawn(shares, 0.6, 0.12)
    if clean or shorter < 2 * side:
        return clean, shares
    blocks = in_blocks(levels, side).mean((2, 3))
    # The median difference of blocks is that of pixels over their side for white noise, and 1.24 times as much or more
    # in photos with such noise. Blocks that are alike but for noise differ by up to 2.5 times as much.
    noise = _usual_step(levels) / side
    white = _usual_step(blocks) <= 1.2 * noise
    shares = evenness(blocks, 4, max(FLAT_RANGE, 2.5 * noise) if white else FLAT_RANGE)
    return _drawn(shares, 0.2, 0.35), shares


def _drawn(shares: Evenness, least_alike: float, most_little: float) -> bool:
    # A soft photo has hardly any edges: nearly all neighbours that are not alike differ a little.
    return shares.alike >= least_alike and shares.little <= min(most_little, 0.85 * (1.0 - shares.alike) + 1e-9)


def _usual_step(levels: np.ndarray) -> float:
    """Return the median difference of neighbours, in levels: 0 but for noise and texture."""
    return float(np.median(np.concatenate([step.ravel() for step in steps(levels)])))


def evenness(levels: np.ndarray, tile: int, even: float = FLAT_RANGE) -> Evenness:
    """Return the evenness of a picture (H, W, C) in 0..255 in those tiles of tile x tile px that are not all alike.
    Neighbours are alike that differ by at most `even` levels.
    """
    pairs, alike, little = (np.zeros(levels.shape[:2], dtype=np.int32) for _ in range(3))
    for step in steps(levels):
        at = tuple(slice(side) for side in step.shape)
        pairs[at] += 1
        alike[at] += step <= even
        little[at] += (step > even) & (step <= APART)
    # The tiles at the right and at the bottom may be narrower.
    rows, columns = (np.arange(0, length, tile) for length in levels.shape[:2])
    pairs, alike, little = (
        np.add.reduceat(np.add.reduceat(counts, rows, axis=0), columns, axis=1) for counts in (pairs, alike, little)
    )
    busy = alike < pairs
    if not busy.any():
        return Evenness(1.0, 0.0)
    total = float(pairs[busy].sum())
    return Evenness(float(alike[busy].sum()) / total, float(little[busy].sum()) / total)


@record
class Contrasts:
    """saved: nats a pair that noise and edges save against one scale of differences. edges: share of pairs with one."""

    saved: float
    edges: float

    @property
    def drawn(self) -> bool:
        """True if the picture is a drawing: hardly any nats are lost, and enough are saved if each edge counts as
        1.5, since photos have large differences but hardly edges. Only some drawings of 16 px have edges between more
        than 0.9 of the pairs.
        """
        return self.saved > -0.03 and self.saved + 1.5 * self.edges > SAVED and self.edges <= 0.9

    def __str__(self) -> str:
        return f"edges between {100 * self.edges:.0f} % of pixels {ASIDE} px apart, {self.saved:.2f} nats saved by them"


def contrasts(levels: np.ndarray) -> Contrasts | None:
    """Return the contrasts of a picture (H, W, C) in 0..255; None if all pixels ASIDE px apart are alike.

    Differences in the widest channel are either a mixture of normal noise, of at least a level, and edges of any size,
    fitted by expectation and maximisation (Dempster, Laird and Rubin 1977); or exponential.
    """
    across, down = levels[:, ASIDE:] - levels[:, :-ASIDE], levels[ASIDE:] - levels[:-ASIDE]
    sizes = np.concatenate([largest(np.abs(steps)).ravel() for steps in (across, down)]).astype(np.float64)
    if not len(sizes) or not sizes.any():
        return None
    square = sizes * sizes
    noise, edges, any_size = 2.0, 0.3, 1.0 / 255.0  # levels, a share, and a density per level
    even = _noisy(square, noise, edges)
    for _ in range(20):
        share = even / (even + edges * any_size)
        edges = float(np.clip(1.0 - share.mean(), 0.01, 0.99))
        noise = max(1.0, float(np.sqrt((share * square).sum() / max(share.sum(), 1e-9))))
        even = _noisy(square, noise, edges)
    scale = max(0.5, float(sizes.mean()))
    drawn, smooth = np.log(even + edges * any_size), -np.log(scale) - sizes / scale
    return Contrasts(float((drawn - smooth).mean()), edges)


def _noisy(square: np.ndarray, noise: float, edges: float) -> np.ndarray:
    """Return (n,) the density of differences, by their squares, of the share 1 - edges of pairs with one fill."""
    return (1.0 - edges) * np.sqrt(2.0 / np.pi) / noise * np.exp(-square / (2.0 * noise * noise))
