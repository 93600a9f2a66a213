"""Imported by the process that workers are forked from: what each of them would spend seconds on."""

import contextlib

# What fails here fails again in each worker, which says so in its job's outcome.
with contextlib.suppress(Exception):
    import cubicsplat_cli.pipeline.vectorize  # noqa: F401
    from cubicsplat_cli.evaluate.rerender import choose_renderer

    choose_renderer()
