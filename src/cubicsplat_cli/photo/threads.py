"""Keeps torch's threads out of the engine's way."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def one_torch_thread() -> Iterator[None]:
    """Within, torch computes on the calling thread alone, where it is in use at all.

    The few tensor operations between the engine's steps are small, and OpenMP's threads go on spinning after each of
    them: on two cores that took 8 % of a fit.
    """
    torch = sys.modules.get("torch")
    if torch is None:
        yield
        return
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(before)
