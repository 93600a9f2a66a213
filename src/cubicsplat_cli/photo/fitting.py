"""A fit from its picture to its result: over a smaller copy, and with other numbers of curves, where asked for."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.photo.inputs import NO_INPUTS, FitInputs, FitResult
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.progress import FrameRecorder, Progress
from cubicsplat_cli.settings import FitSettings


def fit(
    target: np.ndarray,
    settings: FitSettings,
    on_progress: Callable[[Progress], None] | None = None,
    recorder: FrameRecorder | None = None,
    inputs: FitInputs = NO_INPUTS,
) -> FitResult:
    """Fits a scene to a picture (H, W, 3), or (H, W, 4) premultiplied RGBA, float32 in [0, 1].

    recorder: keeps scenes on the way. inputs: what else the fit is given.

    An interrupt (Ctrl-C) ends the fit early with the best scene so far. Raises InputError for a picture of another
    form, EngineError where the engine cannot run or meets a value that is not finite. A GPU that fails on the way
    leaves the state that the fit had come to, with a note.
    """
    return Fitting(target, settings, on_progress, recorder, inputs).finish()


class Fitting(FitLoop):
    """A fit in parts, between which the number of its curves may change; the parameters and errors are those of `fit`.

    rough: a smaller copy of the picture, on which all but the exact finish is done, and its inputs. Only fits that do
    not begin with a drawing come in parts, or have such a copy.
    """

    def __init__(
        self,
        target: np.ndarray,
        settings: FitSettings,
        on_progress: Callable[[Progress], None] | None = None,
        recorder: FrameRecorder | None = None,
        inputs: FitInputs = NO_INPUTS,
        rough: tuple[np.ndarray, FitInputs] | None = None,
    ) -> None:
        picture = _checked(target, inputs)
        settings = settings.for_size(target.shape[1], target.shape[0])
        # The picture and inputs of the exact finish, if it has others.
        self._finish: tuple[np.ndarray, FitInputs] | None = None
        if rough is not None and settings.recipe.finish > 0.0:
            self._finish = picture, inputs
            picture, inputs = _checked(*rough), rough[1]
        super().__init__(picture, settings, inputs, on_progress, recorder)

    def finish(self) -> FitResult:
        if self._finish is not None and self.relax():
            self.go_over_to(*self._finish)
        return super().finish()


def _checked(target: np.ndarray, inputs: FitInputs) -> np.ndarray:
    """The picture as the engines take it. Raises InputError where it, or its weights, cannot be fitted."""
    if target.ndim != 3 or target.shape[2] not in (3, 4) or 0 in target.shape:
        raise InputError(f"the picture must have shape (height, width, 3 or 4), not {target.shape}")
    if not np.isfinite(target).all():
        raise InputError("the picture has values that are not finite")
    weights = inputs.weights
    if weights is not None and (
        weights.shape != target.shape[:2] or not np.isfinite(weights).all() or weights.min() < 0 or not weights.any()
    ):
        raise InputError(f"weights must be at least 0, not all 0, and of shape {target.shape[:2]}")
    return np.ascontiguousarray(target, dtype=np.float32)
