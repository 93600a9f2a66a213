"""Variables that are the same, or opposite: fewer that move freely."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse


@dataclass(frozen=True)
class Tie:
    """One variable is sign times another, sign 1 or -1; numbers below 0 are of what is fixed."""

    one: int
    other: int
    sign: float


def tie_matrix(count: int, ties: Sequence[Tie]) -> sparse.csr_matrix:
    """(count, free): how `count` variables follow from the free ones. What is tied to something fixed, or is its own
    opposite, is fixed: its row is empty.
    """
    # The last root stands for all that is fixed.
    root, sign = list(range(count + 1)), [1.0] * (count + 1)

    def find(i: int) -> tuple[int, float]:
        factor = 1.0
        while root[i] != i:
            factor *= sign[i]
            i = root[i]
        return i, factor

    for tie in ties:
        (a, own), (b, other) = (find(k if k >= 0 else count) for k in (tie.one, tie.other))
        if a == b:
            if a != count and own != tie.sign * other:
                root[a] = count
            continue
        low, high = (a, b) if b == count else (b, a)
        root[low], sign[low] = high, own * tie.sign * other
    found = [find(i) for i in range(count)]
    free = np.unique([r for r, _ in found if r != count])
    rows = np.array([i for i, (r, _) in enumerate(found) if r != count], dtype=int)
    columns = np.searchsorted(free, [found[i][0] for i in rows])
    return sparse.csr_matrix(([found[i][1] for i in rows], (rows, columns)), shape=(count, len(free)))
