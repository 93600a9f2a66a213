"""Worker processes that the tests need not wait for."""

from __future__ import annotations

import importlib.util
import multiprocessing
import multiprocessing.resource_tracker
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from cubicsplat_cli.jobs import pool

# What a worker would spend seconds on, the test runner's own start included.
IMPORTED = ["cubicsplat_cli.pipeline.vectorize", "cairosvg", "pytest"]


@contextmanager
def forked_from_a_warm_process() -> Iterator[None]:
    """Within, a process that would be spawned is forked from one that has imported torch and has done nothing else.

    It is a process like any other, and nothing of the parent's is in it; only its start is quick. The workers of the
    command are forked from it too, as they are from one of their own where users start it.
    """
    if "forkserver" not in multiprocessing.get_all_start_methods():  # Windows
        yield
        return
    warm, real = multiprocessing.get_context("forkserver"), multiprocessing.get_context
    for name in IMPORTED:  # a name that is none would be passed over in silence
        assert importlib.util.find_spec(name) is not None, name
    warm.set_forkserver_preload(IMPORTED)
    pool.PRELOADED[:] = IMPORTED

    def get_context(method: str | None = None) -> Any:
        return warm if method == "spawn" else real(method)

    multiprocessing.get_context = get_context
    try:
        yield
    finally:
        multiprocessing.get_context = real


def start_what_outlives_a_pool() -> None:
    """Start multiprocessing's own helper processes now, so that they do not inherit streams opened later."""
    if "forkserver" in multiprocessing.get_all_start_methods():
        from multiprocessing import forkserver

        forkserver.ensure_running()
    else:
        multiprocessing.resource_tracker.ensure_running()
