"""Pictures read row by row: they are compared without a float copy of the whole."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.scaled import Tile, draw_part
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.record import record

if TYPE_CHECKING:
    from cubicsplat_cli.scene import LayeredScene, Scene


@record
class ImageSource:
    """A picture of width x height px.

    rows: gives the rows from a first up to, but without, a last one: (n, width, 3) float32 in [0, 1], or premultiplied
    (n, width, 4) where it is `transparent`.
    """

    width: int
    height: int
    transparent: bool
    rows: Callable[[int, int], np.ndarray]


def of_picture(picture: Picture) -> ImageSource:
    """A loaded picture."""
    rgb, alpha = picture.rgb, picture.alpha
    if alpha is None:
        return ImageSource(picture.width, picture.height, False, lambda top, bottom: rgb[top:bottom])

    def rows(top: int, bottom: int) -> np.ndarray:
        part = alpha[top:bottom, :, None]
        return np.concatenate([rgb[top:bottom] * part, part], axis=2)

    return ImageSource(picture.width, picture.height, True, rows)


def of_pixels(pixels: np.ndarray) -> ImageSource:
    """A drawn picture: (H, W, 4) uint8 straight RGBA or (H, W, 3) uint8 RGB. InputError for anything else."""
    if pixels.dtype != np.uint8 or pixels.ndim != 3 or pixels.shape[2] not in (3, 4):
        raise InputError(f"a drawn picture must be (H, W, 3 or 4) uint8, not {pixels.shape} {pixels.dtype}")
    height, width, channels = pixels.shape
    transparent = channels == 4 and pixels.size > 0 and int(pixels[..., 3].min()) < 255

    def rows(top: int, bottom: int) -> np.ndarray:
        if not transparent:
            return pixels[top:bottom, :, :3] / np.float32(255)
        values = pixels[top:bottom] / np.float32(255)
        values[..., :3] *= values[..., 3:]
        return values

    return ImageSource(width, height, transparent, rows)


def of_values(values: np.ndarray) -> ImageSource:
    """A float picture, (H, W, 3) or premultiplied (H, W, 4); values are clipped to [0, 1] and not rounded to 8 bits.

    Raises InputError for anything else, and where a value is not finite.
    """
    if values.ndim != 3 or values.shape[2] not in (3, 4):
        raise InputError(f"a picture must be (H, W, 3 or 4), not {values.shape}")
    if not np.isfinite(values).all():
        raise InputError("the picture holds values that are not finite")
    height, width, channels = values.shape

    def rows(top: int, bottom: int) -> np.ndarray:
        return np.clip(values[top:bottom], 0.0, 1.0, dtype=np.float32)

    return ImageSource(width, height, channels == 4, rows)


def of_scene(
    scene: Scene | LayeredScene | None, width: int, height: int, samples: int, threads: int | None = None
) -> ImageSource:
    """The engine's exact picture of a scene at width x height px; of None a transparent one.

    samples: edges per cubic at most. Each call for rows draws them.
    """
    if scene is None:
        return ImageSource(width, height, True, lambda top, bottom: np.zeros((bottom - top, width, 4), np.float32))
    # Most of what is measured is no scene.
    from cubicsplat_cli.scene import LayeredScene, scaled_scene

    if isinstance(scene, LayeredScene):
        return _of_layers(scene.scaled(width, height), samples, threads)
    sized = scaled_scene(scene, width, height)

    def rows(top: int, bottom: int) -> np.ndarray:
        return np.clip(draw_part(sized, 1, Tile(0, top, width, bottom - top), samples, threads), 0.0, 1.0)

    return ImageSource(width, height, scene.background is None, rows)


def _over(below: np.ndarray, above: np.ndarray) -> np.ndarray:
    """One picture (H, W, 4), premultiplied, laid over another."""
    return above + below * (np.float32(1.0) - above[..., 3:])


def _of_layers(scene: LayeredScene, samples: int, threads: int | None) -> ImageSource:
    """The engine's exact picture of layers, each drawn as a whole, clipped, and laid over those before."""
    from cubicsplat_cli.scene import EmbeddedImage

    def rows(top: int, bottom: int) -> np.ndarray:
        tile = Tile(0, top, scene.width, bottom - top)
        out: np.ndarray = np.zeros((bottom - top, scene.width, 4), np.float32)
        for layer in scene.layers:
            drawn: np.ndarray = np.zeros_like(out)
            for each in layer.scenes:
                if isinstance(each, EmbeddedImage):
                    drawn = _over(drawn, each.rows(top, bottom))
                else:
                    drawn = _over(drawn, draw_part(each, 1, tile, samples, threads))
            if layer.clip is not None:
                drawn *= draw_part(layer.clip, 1, tile, samples, threads)[..., 3:]
            out = _over(out, drawn)
        return np.clip(out, 0.0, 1.0)

    return ImageSource(scene.width, scene.height, True, rows)
