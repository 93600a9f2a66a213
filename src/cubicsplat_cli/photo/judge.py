"""What exact pictures say of a fit's parameters: how good they are, and what each of their curves is worth."""

from __future__ import annotations

from collections.abc import Callable

from cubicsplat_cli.photo.best import Best
from cubicsplat_cli.photo.objective import Objective
from cubicsplat_cli.photo.parameters import Parameters
from cubicsplat_cli.photo.result import psnr
from cubicsplat_cli.raster.engine import Engine, SceneArrays
from cubicsplat_cli.raster.loss import image_loss
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene.arrays import Array

CHANNELS_COMPARED = 3  # PSNR counts colour channels, over black and white alike


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
        return self.engine.gradients(
            self.drawn(parameters), self.exact, target=self.objective.goal, weights=self.objective.weights,
            penalty=self.objective.judged_by, importance="loo",
        )[1]["importance"]  # fmt: skip

    def level(self, loss: float | Array, image: Array) -> float:
        """dB of a picture, whose loss is known."""
        if self.objective.squared:
            return psnr(float(loss), self.values)
        return psnr(float(image_loss(image, self.objective.goal, self.objective.weights)), self.values)

    def without_idle(self, best: Best, frozen: int) -> Parameters:
        """The best parameters, less those of them, but the last `frozen`, whose leave-one-out importance is not
        positive; with them where the picture is better for that.
        """
        worth = self.worth(best.parameters)
        keep = worth > 0
        # A scene has at least one curve.
        keep[int(worth.argmax())] = True
        if frozen:
            keep[-frozen:] = True
        if bool(keep.all()):
            return best.parameters
        rest = best.parameters.chosen(keep)
        # Two curves may each be of no use only while the other is there: so all are dropped only if that is better.
        return rest if self.loss(rest) <= best.loss else best.parameters

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
