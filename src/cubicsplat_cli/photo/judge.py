"""What exact pictures say of a fit's parameters: how good they are, and what each of their curves is worth."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from cubicsplat_cli.photo.objective import Objective
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.photo.result import db_ratio, psnr
from cubicsplat_cli.raster.engine import Engine, SceneArrays
from cubicsplat_cli.raster.loss import image_loss
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene.arrays import Array, as_numpy, like

CHANNELS_COMPARED = 3  # PSNR counts colour channels, over black and white alike
# dB of the finished picture. A curve that adds less shows in no pixel, but takes its bytes and may be a speck beside a
# silhouette; and all that are left out may cost no more than a hundredth, the last digit that fits are compared by.
IDLE_DB, IDLE_TOTAL_DB = 1e-4, 0.01
IDLE_ROUNDS = 3  # since curves are worth something else without the others; each round takes as long as two steps


class Judge:
    """objective: of the fit, and with it its goal. exact: how pictures are drawn. drawn: gives parameters as the engine
    takes them.
    """

    def __init__(
        self, engine: Engine, objective: Objective, exact: RasterSettings, drawn: Callable[[Parameters], SceneArrays]
    ) -> None:
        self.engine, self.objective, self.exact, self.drawn = engine, objective, exact, drawn
        self.values = objective.goal.shape[0] * objective.goal.shape[1] * CHANNELS_COMPARED

    def picture(self, parameters: Parameters) -> Array:
        return self.engine.render(self.drawn(parameters), self.exact)

    def loss(self, parameters: Parameters) -> float:
        """That of the exact picture."""
        objective = self.objective
        if not objective.pixelwise:
            return float(objective.of(self.picture(parameters)))
        return self.engine.gradients(
            self.drawn(parameters), self.exact, target=objective.goal, weights=objective.weights,
            penalty=objective.penalty,
        )[0]  # fmt: skip

    def worth(self, parameters: Parameters) -> Array:
        """(N,): how much the loss of the exact picture would rise without each curve."""
        return self._measured(parameters)[1]

    def _measured(self, parameters: Parameters) -> tuple[float, Array]:
        """The loss by which curves are judged, and by how much it would rise without each of them."""
        loss, found = self.engine.gradients(
            self.drawn(parameters), self.exact, target=self.objective.goal, weights=self.objective.weights,
            penalty=self.objective.judged_by, importance="loo",
        )  # fmt: skip
        return loss, found["importance"]

    def level(self, loss: float | Array, image: Array) -> float:
        """dB of a picture, whose loss is known."""
        if self.objective.squared:
            return psnr(float(loss), self.values)
        return psnr(float(image_loss(image, self.objective.goal, self.objective.weights)), self.values)

    def without_idle(self, parameters: Parameters, frozen: int) -> Parameters:
        """The parameters without the curves, but the last `frozen`, whose leave-one-out importance is less than
        IDLE_DB: as many as cost less than IDLE_TOTAL_DB together.
        """
        kept, loss = parameters, self.loss(parameters)
        most = loss * db_ratio(IDLE_TOTAL_DB)
        for _ in range(IDLE_ROUNDS):
            idle = self._idle(kept, frozen, (most - loss) / max(loss, 1e-300))
            # Two curves may each be of no use only while the other is there.
            while len(idle) and (without := self.loss(rest := _left(kept, idle))) > most:
                idle = idle[: len(idle) // 2]
            if not len(idle):
                break
            kept, loss, most = rest, without, min(most, without * db_ratio(IDLE_TOTAL_DB))
        return kept

    def _idle(self, parameters: Parameters, frozen: int, allowed: float) -> np.ndarray:
        """The curves worth less than IDLE_DB, those of least worth first: as many as are worth at most `allowed` times
        the loss together, and never all.
        """
        loss, found = self._measured(parameters)
        worth = as_numpy(found)[: parameters.curves - frozen].astype(np.float64) / max(loss, 1e-300)
        order = np.argsort(worth, kind="stable")[: parameters.curves - 1]
        worth = worth[order]
        return order[(worth <= db_ratio(IDLE_DB) - 1.0) & (np.maximum(worth, 0.0).cumsum() <= allowed)]

    def of_soft_edges(self, parameters: Parameters, samples: int) -> str:
        """What a file loses against soft edges, drawn with so many edges per cubic, in a sentence."""
        soft, crisp = (
            psnr(self.engine.gradients(self.drawn(parameters), raster, target=self.objective.goal)[0], self.values)
            for raster in (RasterSettings("relaxed", 1.0, samples), self.exact)
        )
        return (
            f"no SVG can show soft edges: with them the fit has {soft:.2f} dB, with the file's crisp edges "
            f"{crisp:.2f} dB"
        )


def _left(parameters: Parameters, left_out: np.ndarray) -> Parameters:
    keep = np.setdiff1d(np.arange(parameters.curves), left_out)
    return parameters.chosen(like(parameters.points, keep, "int64"))
