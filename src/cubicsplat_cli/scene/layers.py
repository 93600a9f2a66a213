"""Scenes on one another, some of them clipped: drawings with shading."""

from __future__ import annotations

import io
from functools import cached_property

import numpy as np
from PIL import Image

from cubicsplat_cli.record import record
from cubicsplat_cli.scene.scene import Scene


@record
class EmbeddedImage:
    """An opaque picture on a canvas of canvas[0] x canvas[1] px: data, a PNG or JPEG file, within a box in px."""

    canvas: tuple[int, int]
    left: float
    top: float
    width: float
    height: float
    data: bytes

    curves = 0

    def scaled(self, width: int, height: int) -> EmbeddedImage:
        """Return the same on a canvas of another size."""
        across, down = width / self.canvas[0], height / self.canvas[1]
        box = self.left * across, self.top * down, self.width * across, self.height * down
        return EmbeddedImage((width, height), *box, self.data)

    def rows(self, top: int, bottom: int) -> np.ndarray:
        """Return (bottom - top, canvas[0], 4) float32: rows of premultiplied RGBA in [0, 1], at the nearest px."""
        return self._pixels[top:bottom] / np.float32(255.0)

    @cached_property
    def _pixels(self) -> np.ndarray:
        """(H, W, 4) uint8 of the canvas, kept since rows are requested strip by strip."""
        left, top = round(self.left), round(self.top)
        size = max(1, round(self.left + self.width) - left), max(1, round(self.top + self.height) - top)
        canvas = Image.new("RGBA", self.canvas)
        with Image.open(io.BytesIO(self.data), formats=("PNG", "JPEG")) as image:
            canvas.paste(image.convert("RGB").resize(size, Image.Resampling.LANCZOS), (left, top))
        return np.asarray(canvas)


@record
class SceneLayer:
    """A scene, and a scene or picture `over` it, if any, visible only within `clip`: the filled curves of a scene,
    or None for no limit. All are of one size and without a background.
    """

    scene: Scene
    over: Scene | EmbeddedImage | None = None
    clip: Scene | None = None

    @property
    def scenes(self) -> tuple[Scene | EmbeddedImage, ...]:
        """The scenes and pictures to draw, back to front."""
        return (self.scene,) if self.over is None else (self.scene, self.over)


@record
class LayeredScene:
    """Layers back to front on a transparent canvas of width x height px."""

    width: int
    height: int
    layers: tuple[SceneLayer, ...]

    @property
    def curves(self) -> int:
        """The number of primitives in all layers."""
        return sum(scene.curves for layer in self.layers for scene in layer.scenes)

    def scaled(self, width: int, height: int) -> LayeredScene:
        """Return the same on a canvas of another size; see `Scene.scaled`."""
        size, layers = (width, height), []
        for layer in self.layers:
            over, clip = layer.over and layer.over.scaled(*size), layer.clip and layer.clip.scaled(*size)
            layers.append(SceneLayer(layer.scene.scaled(*size), over, clip))
        return LayeredScene(width, height, tuple(layers))


AnyScene = Scene | LayeredScene
