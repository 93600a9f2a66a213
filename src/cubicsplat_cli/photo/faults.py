"""Values that are not finite, which end a fit."""

from __future__ import annotations

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.raster.engine import Engine


def check_finite(engine: Engine, parameters: Parameters, step: int, *, wait: bool = False) -> None:
    """Before a step: within it one bad curve spoils every curve that it shares a pixel with. Raises EngineError.

    A GPU's engine looks by itself; without `wait` this is what it found some steps ago.
    """
    if fault := engine.fault(wait):
        raise broken_down(engine, f"curve {fault[0]} has a non-finite value", step)
    if not engine.runs_ahead and (found := parameters.first_non_finite()):
        raise broken_down(engine, f"curve {found[0]} has a non-finite value in {found[1]}", step)


def broken_down(engine: Engine, where: str, step: int) -> EngineError:
    """The error, of the place and step that the engine has noted, if it has: it may have happened some steps ago."""
    if fault := engine.fault():
        where, step = f"curve {fault[0]} has a non-finite value", fault[1]
    return EngineError(f"the fit broke down at step {step}: {where}; lower the step sizes or change --seed")
