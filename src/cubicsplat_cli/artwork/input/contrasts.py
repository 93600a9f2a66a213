"""Differences of pixels a few px apart in a small picture: noise or edges in drawings, any amount in photos.

In pictures of a few px hardly anything is even, and noise and JPEG leave nothing as it was. But past the blends on an
edge there are two inks: a drawing's differences are those of noise, or they are large and of any size. A photo's
become ever rarer with their size. Which describes them in less is told by their likelihoods under either. In numpy
alone, since photos are asked this too.
"""

from __future__ import annotations

import numpy as np

from cubicsplat_cli.records import dataclass

APART = 3  # px between the pixels of a pair, past an edge's blends
LEAST_NOISE, LEAST_SCALE = 1.0, 0.5  # levels
FIRST_NOISE, FIRST_EDGES, LEAST_EDGES = 2.0, 0.3, 0.01  # levels, and shares of the pairs
ROUNDS = 20  # of expectation and maximisation
# A pair's nats saved must not be fewer, nor those with what a pair with an edge counts beside: photos have tails, but
# hardly edges. More edges than that only some drawings of 16 px have.
LEAST_SAVED, FOR_AN_EDGE, LEAST_IN_ALL, MOST_EDGES = -0.03, 1.5, 0.75, 0.9


@dataclass(frozen=True)
class Contrasts:
    """saved: nats a pair by which noise and edges describe the differences in less than one scale does. edges: share
    of the pairs with an edge between them.
    """

    saved: float
    edges: float

    @property
    def drawn(self) -> bool:
        """Whether the picture is a drawing."""
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
    sizes = np.concatenate([np.abs(steps).max(axis=2).ravel() for steps in (across, down)]).astype(np.float64)
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
