"""Regions that touch, and regions that enclose others."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np


def touching(labels: np.ndarray) -> dict[int, dict[int, int]]:
    """For each region its neighbours and how many cracks they share."""
    count = int(labels.max()) + 1
    out: dict[int, dict[int, int]] = {i: {} for i in range(count)}
    for a, b in ((labels[1:], labels[:-1]), (labels[:, 1:], labels[:, :-1])):
        edge = a != b
        u, v = a[edge].astype(np.int64), b[edge].astype(np.int64)
        keys, sizes = np.unique(np.minimum(u, v) * count + np.maximum(u, v), return_counts=True)
        for key, size in zip(keys.tolist(), sizes.tolist(), strict=True):
            i, j = divmod(key, count)
            out[i][j] = out[i].get(j, 0) + size
            out[j][i] = out[j].get(i, 0) + size
    return out


def on_the_border(labels: np.ndarray) -> set[int]:
    """The regions of labels (H, W) that reach the canvas's border."""
    return set(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]).tolist())


def enclosures(touching: dict[int, dict[int, int]], border: set[int]) -> dict[int, set[int]]:
    """For each region that has holes the regions within them: those from which all ways to the border lead through it.

    touching: the neighbours of each. border: the regions on the canvas's border. A region encloses what a depth-first
    search from the border finds below it, where no edge leads from there to what was found earlier (Hopcroft and Tarjan
    1973).
    """
    number: dict[int, int] = {}
    order: list[int] = []
    earliest: dict[int, int] = {}
    inside: dict[int, set[int]] = {}

    def enter(region: int) -> None:
        number[region] = len(order)
        earliest[region] = -1 if region in border else len(order)
        order.append(region)
        path.append((region, iter(touching[region])))

    path: list[tuple[int, Iterator[int]]] = []
    for start in sorted(border):
        if start not in number:
            enter(start)
        while path:
            region, beside = path[-1]
            other = next(beside, None)
            if other is not None:
                if other not in number:
                    enter(other)
                else:
                    earliest[region] = min(earliest[region], number[other])
                continue
            path.pop()
            if path:
                before = path[-1][0]
                earliest[before] = min(earliest[before], earliest[region])
                if earliest[region] >= number[before]:
                    inside.setdefault(before, set()).update(order[number[region] :])
    return dict(sorted(inside.items()))
