"""Scenes on one another, some of them clipped: what a drawing with shading is."""

from __future__ import annotations

from dataclasses import replace

from cubicsplat_cli.records import dataclass
from cubicsplat_cli.scene.scene import Scene, scaled_scene


@dataclass(frozen=True, eq=False)
class SceneLayer:
    """A scene, or one over another one, of which only what lies within `clip` is seen: the curves, filled, of a further
    scene; all of it with None. All are of one size and without a background. name: of what is shaded, empty for shapes.
    """

    scene: Scene
    over: Scene | None = None
    clip: Scene | None = None
    name: str = ""

    @property
    def scenes(self) -> tuple[Scene, ...]:
        """What is drawn, back to front."""
        return (self.scene,) if self.over is None else (self.scene, self.over)


@dataclass(frozen=True, eq=False)
class LayeredScene:
    """Layers back to front on a transparent canvas of width x height px."""

    width: int
    height: int
    layers: tuple[SceneLayer, ...]

    @property
    def curves(self) -> int:
        """The primitives of all layers."""
        return sum(scene.curves for layer in self.layers for scene in layer.scenes)

    def scaled(self, width: int, height: int) -> LayeredScene:
        """The same on a canvas of another size; see `scaled_scene`."""
        layers = tuple(
            replace(
                layer,
                scene=scaled_scene(layer.scene, width, height),
                over=layer.over and scaled_scene(layer.over, width, height),
                clip=layer.clip and scaled_scene(layer.clip, width, height),
            )
            for layer in self.layers
        )
        return LayeredScene(width, height, layers)
