"""The best parameters of a fit so far."""

from __future__ import annotations

import math

from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.scene.arrays import Array, is_array, namespace


class Best:
    """A copy of the parameters whose picture has had the least loss, where the parameters live.

    A loss that comes as an array on a GPU is compared there: nothing waits for it before `loss` is read.
    """

    def __init__(self) -> None:
        self._loss: float | Array = math.inf
        self._parameters: Parameters | None = None

    @property
    def empty(self) -> bool:
        return self._parameters is None

    @property
    def loss(self) -> float:
        return float(self._loss)

    @property
    def parameters(self) -> Parameters:
        """Raises ValueError before anything was considered."""
        if self._parameters is None:
            raise ValueError("no parameters have been considered yet")
        return self._parameters

    def consider(self, loss: float | Array, parameters: Parameters) -> None:
        """Keeps the parameters if their loss is the least so far."""
        known = self._parameters
        if known is None:
            self._loss, self._parameters = loss, parameters.copy()
        elif known.curves != parameters.curves:
            if float(loss) < self.loss:
                self._loss, self._parameters = loss, parameters.copy()
        elif is_array(loss):
            self._choose(loss, parameters)
        elif loss < self.loss:
            self._loss = loss
            known.overwrite(parameters)

    def _choose(self, loss: Array, parameters: Parameters) -> None:
        xp, better, theirs = namespace(loss), loss < self._loss, parameters.arrays_by_name()
        for name, mine in self.parameters.arrays_by_name().items():
            mine[...] = xp.where(better, theirs[name], mine)
        self._loss = xp.where(better, loss, self._loss)
