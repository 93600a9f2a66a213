"""Train the network of `finer_labels` of raster/unmix.py on random shapes: `python tools/train_subpixels.py`.

A picture of two fills shows the share of the second one in each pixel. The network tells, from the shares of the pixels
around one, the share in each of its 4 x 4 steps: what shapes make likely. Its shapes are lines, arcs, curves, outlines,
strokes like those of letters, ellipses and polygons, 0.3 px and more wide. It takes 20 minutes and 3 GB on a core.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from PIL import Image, ImageDraw
from torch import nn

from cubicsplat_cli.raster.unmix import SUBPIXELS

CANVAS, FINE, STEPS = 64, 16, 4  # px of a scene, samples and steps along a side of each
WINDOW = 9  # px a side of what the network sees
SCENES, ROUNDS, BATCH, HIDDEN, SPEED = 12_000, 40_000, 4096, 128, 3e-3
_HALF = WINDOW // 2


class Scene:
    """A random picture of two fills, drawn in FINE x FINE samples a pixel without anti-aliasing."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng, self.image = rng, Image.new("1", (CANVAS * FINE, CANVAS * FINE))
        self._draw, self._snaps = ImageDraw.Draw(self.image), rng.random() < 0.3
        letters, thin = rng.random() < 0.25, rng.random() < 0.25
        for _ in range(rng.integers(4, 22)):
            self._ink = int(rng.random() < 0.7)
            if letters and rng.random() < 0.5:
                self._letters()
            else:
                kinds = [self._line] if thin else [self._line, self._line, self._ellipse, self._polygon, self._hatching]
                kinds[rng.integers(len(kinds))]()
        self.inside = np.asarray(self.image) != (rng.random() < 0.5)

    def _size(self, least: float, most: float, count: int = 1) -> np.ndarray:
        """Lengths that are as likely to lie between 1 and 2 px as between 2 and 4."""
        return np.exp(self.rng.uniform(math.log(least), math.log(most), count))

    def _snapped(self, lengths: np.ndarray, least: float = 0.0) -> np.ndarray:
        """Lengths as they are, or in halves of a px as in drawings for screens."""
        return np.maximum(np.rint(2.0 * lengths) / 2.0, least) if self._snaps else lengths

    def _fill(self, points: np.ndarray) -> None:
        self._draw.polygon([(x, y) for x, y in (points * FINE).tolist()], fill=self._ink)

    def _stroke(self, points: np.ndarray, width: float) -> None:
        along = np.diff(points, axis=0)
        across = along[:, ::-1] * [-0.5, 0.5] * width / np.maximum(np.hypot(*along.T), 1e-9)[:, None]
        for start, end, side in zip(points[:-1], points[1:], across, strict=True):
            self._fill(np.array([start + side, end + side, end - side, start - side]))
        for x, y in points if self.rng.random() < 0.2 else points[1:-1]:
            self._fill(_arc(x, y, width / 2.0, width / 2.0, 0.0, 2.0 * math.pi))

    def _path(self) -> np.ndarray:
        start, kind = self.rng.uniform(-4, CANVAS + 4, 2), self.rng.integers(4)
        if kind == 0:  # a line, often level, upright or at 45 degrees
            turn = self.rng.uniform(0, 2 * math.pi) if self.rng.random() < 0.5 else self.rng.integers(8) * math.pi / 4
            return start + np.outer([0.0, self.rng.uniform(2, 40)], [math.cos(turn), math.sin(turn)])
        if kind == 1:
            (radius,), first = self._size(0.5, 16), self.rng.uniform(0, 2 * math.pi)
            end = first + self.rng.uniform(0.5, 2 * math.pi)
            return _arc(*start, radius, radius * self.rng.uniform(0.6, 1.6), first, end)
        corners = start + np.cumsum(self.rng.normal(0, 8, (self.rng.integers(2, 5) if kind == 2 else 4, 2)), axis=0)
        if kind == 2:
            return corners
        t = np.linspace(0, 1, 48)[:, None]
        return (1 - t) ** 3 * corners[0] + 3 * t * (1 - t) * ((1 - t) * corners[1] + t * corners[2]) + t**3 * corners[3]

    def _line(self) -> None:
        path = self._path()
        self._stroke(self._snapped(path) if len(path) < 5 else path, *self._snapped(self._size(0.3, 4), 0.5))

    def _hatching(self) -> None:
        path, width, turn = self._path(), self.rng.uniform(0.4, 2), self.rng.uniform(0, 2 * math.pi)
        apart = self.rng.uniform(width + 0.5, width + 4) * np.array([math.cos(turn), math.sin(turn)])
        for number in range(self.rng.integers(2, 6)):
            self._stroke(path + number * apart, width)

    def _ellipse(self) -> None:
        turn, radii = self.rng.uniform(0, math.pi), self._size(0.5, 14, 2)
        points = _arc(0.0, 0.0, *radii, 0.0, 2.0 * math.pi)
        turned = points @ [[math.cos(turn), math.sin(turn)], [-math.sin(turn), math.cos(turn)]]
        self._fill(turned + self.rng.uniform(0, CANVAS, 2))

    def _polygon(self) -> None:
        if self.rng.random() < 0.4:
            sides = self._snapped(self._size(0.5, 14, 2), 0.5)
            self._fill(self._snapped(self.rng.uniform(0, CANVAS, 2)) + sides * [[0, 0], [1, 0], [1, 1], [0, 1]])
        else:
            spread = self.rng.normal(0, self.rng.uniform(2, 12), (self.rng.integers(3, 7), 2))
            self._fill(self.rng.uniform(-4, CANVAS + 4, 2) + spread)

    def _letters(self) -> None:
        """A row of signs of one to four strokes each, of one width."""
        height = self.rng.uniform(5, 16)
        width, top, left = height * self.rng.uniform(0.08, 0.2), self.rng.uniform(0, CANVAS - height), -2.0
        while left < CANVAS:
            wide = height * self.rng.uniform(0.3, 0.8)
            box, corner = np.array([wide / 2.0, height / 4.0]), np.array([left, top])
            for _ in range(self.rng.integers(1, 5)):
                kind, places = self.rng.integers(4), self.rng.integers([3, 5], size=(2, 2)).astype(float)
                if kind == 0:  # upright
                    places = np.array([[places[0, 0], 0.0], [places[0, 0], self.rng.choice([2.0, 3.0, 4.0])]])
                elif kind == 1:  # level
                    places = np.array([[0.0, places[0, 1]], [2.0, places[0, 1]]])
                points = corner + places * box
                if kind == 3:
                    middle, tall = corner + box * [1.0, self.rng.integers(1, 4)], self.rng.integers(1, 3)
                    first = self.rng.integers(8) * math.pi / 4
                    points = _arc(*middle, *(box * [1.0, tall]), first, first + math.pi * self.rng.integers(1, 5) / 2)
                self._stroke(points, width)
            left += wide + height * self.rng.uniform(0.15, 0.4)

    def examples(self) -> tuple[np.ndarray, np.ndarray]:
        """Return what the pixels show that have some of both fills: of 255, (n, WINDOW, WINDOW) the shares around each,
        and (n, STEPS, STEPS) those of its steps. Half of the pictures show exact areas, half 4 x 4 samples a pixel.
        """
        fine = self.inside.astype(np.float32)
        apart = FINE // STEPS
        steps = fine.reshape(CANVAS * STEPS, apart, CANVAS * STEPS, apart).mean(axis=(1, 3))
        seen = steps if self.rng.random() < 0.5 else fine[apart // 2 :: apart, apart // 2 :: apart]
        shares = np.rint(255.0 * seen.reshape(CANVAS, STEPS, CANVAS, STEPS).mean(axis=(1, 3)))
        y, x = np.nonzero((shares > 0) & (shares < 255))
        around = np.lib.stride_tricks.sliding_window_view(np.pad(shares, _HALF, mode="edge"), (WINDOW, WINDOW))[y, x]
        own = 255.0 * steps.reshape(CANVAS, STEPS, CANVAS, STEPS).transpose(0, 2, 1, 3)[y, x]
        around, own = _turned(around, own)
        return around.astype(np.uint8), own.astype(np.uint8)


def _turned(around: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return windows (n, WINDOW, WINDOW) and steps (n, STEPS, STEPS), of 255, inverted, mirrored and transposed such
    that a pixel has at most half of the second fill, and most of that lies to the right, and next to that below. The
    network sees no others.
    """

    def changed(where: np.ndarray, change: Callable[[np.ndarray], np.ndarray]) -> None:
        for values in (around, own):
            values[where] = change(values[where])

    around, own = around.copy(), own.copy()
    offsets = np.arange(WINDOW) - float(_HALF)
    changed(around[:, _HALF, _HALF] > 127.5, lambda values: 255.0 - values)
    changed(around.sum(axis=1) @ offsets < 0.0, lambda values: values[:, :, ::-1])
    changed(around.sum(axis=2) @ offsets < 0.0, lambda values: values[:, ::-1])
    right, down = (around.sum(axis=axis) @ offsets for axis in (1, 2))
    changed(down > right, lambda values: values.swapaxes(1, 2))
    return around, own


def _arc(x: float, y: float, across: float, down: float, first: float, last: float) -> np.ndarray:
    turn = np.linspace(first, last, 64)
    return np.stack([x + across * np.cos(turn), y + down * np.sin(turn)], axis=1)


def trained(around: torch.Tensor, own: torch.Tensor) -> nn.Sequential:
    """Return the network that gives the logits (n, STEPS^2) of shares of steps, from -1 to 1 of those around."""
    sizes = [WINDOW**2, HIDDEN, HIDDEN, STEPS**2]
    layers = [nn.Linear(into, out) for into, out in pairwise(sizes)]
    network = nn.Sequential(layers[0], nn.ReLU(), layers[1], nn.ReLU(), layers[2])
    optimizer = torch.optim.AdamW(network.parameters(), weight_decay=1e-4)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, SPEED, ROUNDS)
    for number in range(ROUNDS):
        chosen = torch.randint(len(around), (BATCH,))
        given, wanted = (values[chosen].flatten(1) / 255.0 for values in (around, own))
        logits = network(2.0 * given - 1.0)
        loss = nn.functional.binary_cross_entropy_with_logits(logits, wanted)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        schedule.step()
        if number % 2000 == 1999:
            print(f"round {number + 1}: loss {loss.item():.4f}", flush=True)
    return network


def main() -> None:
    """Draw the scenes, train the network, and write its weights where the package reads them."""
    torch.manual_seed(0)
    rng = np.random.default_rng(0)
    examples = [Scene(rng).examples() for _ in range(SCENES)]
    network = trained(*(torch.from_numpy(np.concatenate(each)) for each in zip(*examples, strict=True)))
    weights = [parameter.detach().numpy().astype(np.float16) for parameter in network.parameters()]
    np.savez_compressed(Path(SUBPIXELS), *weights)


if __name__ == "__main__":
    main()
