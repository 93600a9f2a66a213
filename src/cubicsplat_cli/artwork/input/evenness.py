"""Measure how even a picture is: neighbouring pixels of a drawing are alike, or an edge lies between them.

In a photo most neighbours differ a little. Means of blocks remove what noise and JPEG add. Small pictures have few even
areas, so there the differences of pixels a few px apart are measured, past the blends on an edge. A drawing's
differences are those of noise, or large and of any size; a photo's become ever rarer with their size. The likelihoods
of both models are compared. This module needs numpy alone, because photos are measured too.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.artwork.channels import in_blocks, largest
from cubicsplat_cli.raster.unmix import steps
from cubicsplat_cli.record import record

ALIKE, EDGE = 3.0, 24.0  # levels: neighbours that differ by no more are alike, and between others lies an edge
SMALL = 64  # px of the longer side, up to which other things tell
BLOCK = 4  # px of a block's side at least: so many of a large picture's longer side as make SMALL of it
TILE, BLOCKS = 16, 4  # px and blocks of a tile's side; where all of it is alike it is ground, which does not count
# What drawings may have of neighbours that differ a little, and must have of such that are alike: as they are, where
# clean drawings of 128 px and more mostly have at most 0.09 of the former, photos 0.2 and more, and dots for greys less
# than half of the latter; and in blocks, where photos with noise, as JPEG or blurred have 0.33 and more.
MOST_LITTLE, LEAST_ALIKE = 0.12, 0.6
MOST_LITTLE_BLOCKS, LEAST_ALIKE_BLOCKS = 0.35, 0.2
# The median difference of blocks is that of pixels over their side where these have white noise, and more in photos
# with such noise (1.24 and more): up to WHITE times as much counts as noise. By NOISE times as much blocks differ at
# most that are alike but for it.
WHITE, NOISE = 1.2, 2.5
# Of the neighbours that are not alike, what may differ a little: where hardly any have an edge between them it
# is a soft photo.
SOFT = 0.85
APART = 3  # px between the pixels of a pair, past an edge's blends
LEAST_NOISE, LEAST_SCALE = 1.0, 0.5  # levels
FIRST_NOISE, FIRST_EDGES, LEAST_EDGES = 2.0, 0.3, 0.01  # levels, and shares of the pairs
ROUNDS = 20  # of expectation and maximisation
# A pair's nats saved must not be fewer, nor those with what a pair with an edge counts beside: photos have tails, but
# hardly edges. More edges than that only some drawings of 16 px have.
LEAST_SAVED, FOR_AN_EDGE, LEAST_IN_ALL, MOST_EDGES = -0.03, 1.5, 0.75, 0.9


@record
class Evenness:
    """Shares of the pairs of neighbours that are looked at: those that are alike, and those that differ a little."""

    alike: float
    little: float

    def __str__(self) -> str:
        return f"{100 * self.alike:.0f} % of neighbours alike, {100 * self.little:.0f} % a little off"


def even(levels: np.ndarray) -> tuple[bool, Evenness]:
    """Return whether a picture (H, W, C) in 0..255 of more than SMALL px is as even as drawings are, and what says so.

    What is clear counts as one even colour.
    """
    shorter, longer = sorted(levels.shape[:2])
    found, side = evenness(levels, TILE), max(BLOCK, longer // SMALL)
    clean = _drawn(found, LEAST_ALIKE, MOST_LITTLE)
    if clean or shorter < 2 * side:
        return clean, found
    blocks = in_blocks(levels, side).mean((2, 3))
    noise = _usual_step(levels) / side
    white = _usual_step(blocks) <= WHITE * noise
    found = evenness(blocks, BLOCKS, max(ALIKE, NOISE * noise) if white else ALIKE)
    return _drawn(found, LEAST_ALIKE_BLOCKS, MOST_LITTLE_BLOCKS), found


def _drawn(found: Evenness, least_alike: float, most_little: float) -> bool:
    return found.alike >= least_alike and found.little <= min(most_little, SOFT * (1.0 - found.alike) + 1e-9)


def _usual_step(levels: np.ndarray) -> float:
    """The median difference of neighbours, in levels: 0 but in noise and in texture."""
    return float(np.median(np.concatenate([step.ravel() for step in steps(levels)])))


def evenness(levels: np.ndarray, tile: int, even: float = ALIKE) -> Evenness:
    """Of a picture (H, W, C) in 0..255 where tiles of tile x tile px are not all alike.

    even: levels by which neighbours differ that are alike.
    """
    pairs, alike, little = (np.zeros(levels.shape[:2], dtype=np.int32) for _ in range(3))
    for step in steps(levels):
        at = tuple(slice(side) for side in step.shape)
        pairs[at] += 1
        alike[at] += step <= even
        little[at] += (step > even) & (step <= EDGE)
    pairs, alike, little = (_tiled(counts, tile) for counts in (pairs, alike, little))
    busy = alike < pairs
    if not busy.any():
        return Evenness(1.0, 0.0)
    total = float(pairs[busy].sum())
    return Evenness(float(alike[busy].sum()) / total, float(little[busy].sum()) / total)


def _tiled(counts: np.ndarray, tile: int) -> np.ndarray:
    """The sums of all tiles of (H, W) numbers, those at the right and at the bottom as wide as is left."""
    rows, columns = (np.arange(0, length, tile) for length in counts.shape)
    return np.add.reduceat(np.add.reduceat(counts, rows, axis=0), columns, axis=1)


@record
class Contrasts:
    """saved: nats a pair by which noise and edges describe the differences in less than one scale does. edges: share
    of the pairs with an edge between them.
    """

    saved: float
    edges: float

    @property
    def drawn(self) -> bool:
        """Return whether the picture is a drawing."""
        in_all = self.saved + FOR_AN_EDGE * self.edges
        return self.saved > LEAST_SAVED and in_all > LEAST_IN_ALL and self.edges <= MOST_EDGES

    def __str__(self) -> str:
        return f"edges between {100 * self.edges:.0f} % of pixels {APART} px apart, {self.saved:.2f} nats saved by them"


def contrasts(levels: np.ndarray) -> Contrasts | None:
    """Of a picture (H, W, C) in 0..255; None where all of it is one colour, or pixels so far apart are alike.

    Differences in the channel with most are a mixture of normal noise and edges of any size alike, by expectation and
    maximisation (Dempster, Laird and Rubin 1977), or exponential.
    """
    across, down = levels[:, APART:] - levels[:, :-APART], levels[APART:] - levels[:-APART]
    sizes = np.concatenate([largest(np.abs(steps)).ravel() for steps in (across, down)]).astype(np.float64)
    if not len(sizes) or not sizes.any():
        return None
    square = sizes * sizes
    noise, edges, any_size = FIRST_NOISE, FIRST_EDGES, 1.0 / 255.0
    even = _noisy(square, noise, edges)
    for _ in range(ROUNDS):
        share = even / (even + edges * any_size)
        edges = float(np.clip(1.0 - share.mean(), LEAST_EDGES, 1.0 - LEAST_EDGES))
        noise = max(LEAST_NOISE, float(np.sqrt((share * square).sum() / max(share.sum(), 1e-9))))
        even = _noisy(square, noise, edges)
    scale = max(LEAST_SCALE, float(sizes.mean()))
    drawn, smooth = np.log(even + edges * any_size), -np.log(scale) - sizes / scale
    return Contrasts(float((drawn - smooth).mean()), edges)


def _noisy(square: np.ndarray, noise: float, edges: float) -> np.ndarray:
    """(n,) the density of differences, by their squares, between pixels of one ink, of which there are 1 - edges."""
    return (1.0 - edges) * np.sqrt(2.0 / np.pi) / noise * np.exp(-square / (2.0 * noise * noise))
