"""Imports that take seconds, done once by the process from which workers are forked."""

import contextlib

# A failure here happens again in each worker, which reports it in the outcome of its job.
with contextlib.suppress(Exception):
    import cubicsplat_cli.pipeline.vectorize  # noqa: F401
    from cubicsplat_cli.evaluate.rerender import choose_renderer

    choose_renderer()
