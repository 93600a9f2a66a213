"""Pages: drawings in which some parts are photographs, each a shape with a group of curves that are fitted to it."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from PIL import Image

from cubicsplat_cli.artwork.geometry.outlines import Rectangle, pieces_of_rings
from cubicsplat_cli.artwork.limits import blocks_of, reduction
from cubicsplat_cli.artwork.photo_parts import FRAME, Page, PhotoPart, page_of
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.style import PHOTO
from cubicsplat_cli.files.load import Picture
from cubicsplat_cli.files.weights import Mask
from cubicsplat_cli.formatting import counted
from cubicsplat_cli.options import IMAGE, NONE
from cubicsplat_cli.pipeline.artwork import drawn_outlines
from cubicsplat_cli.pipeline.photo import fitted_photo
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.progress import work
from cubicsplat_cli.scene import EmbeddedImage, Scene
from cubicsplat_cli.scene.arrays import with_channels

JPEG_QUALITY = 92  # of an embedded photo: hardly anybody sees what it loses
NAME = "photo"  # of a shape that is one
NEAR = 64  # levels by which the fill of a part's shape may be off the one it was drawn in: far less than to others
LEAST_COMMON = 0.7  # of the boxes of a part and of its shape


class PartIsLost(Exception):
    """The drawing of a page has no shape for one of its photographs."""


def page_in(task: Task) -> Page | None:
    """The page that a picture shows; None where it is none, or the request is for something else."""
    if not task.request.may_hold_photos or task.recorder is not None or task.target.alpha is not None:
        return None
    target = task.pixels
    factor = reduction(*target.shape[:2])
    if factor > 1:
        target = np.ascontiguousarray(blocks_of(with_channels(target, 4), factor)[..., :3])
    return page_of(target)


def drawn_page(task: Task, page: Page, on_sketch: Callable[[Task, Made], None]) -> Made:
    """The drawing of a page with its photographs.

    on_sketch: given the work on the page without them, and a first version of what has very many shapes; what it raises
    ends the drawing. Raises PartIsLost where there is no shape for a photograph.
    """
    without = _of_pixels(task, page.flat)
    curves = task.settings().for_size(sum(part.size for part in page.parts), 1).curves
    interrupted, embedded = False, task.request.photo_parts == IMAGE

    def with_photos(drawing: Drawing) -> Drawing:
        nonlocal interrupted
        shapes = list(drawing.shapes)
        for part in page.parts:
            if interrupted or work().stopped:
                break
            index = _shape_of(drawing, part)
            if embedded:
                shapes[index] = _with_photo(page, shapes[index], part, _image(page, part))
                continue
            share = max(1, round(curves * part.size / sum(each.size for each in page.parts)))
            photo = _photo(task, page, part, share)
            interrupted |= photo.interrupted
            assert isinstance(photo.scene, Scene)
            shapes[index] = _with_photo(page, shapes[index], part, photo.scene)
        return replace(drawing, shapes=tuple(_recoloured(page, shapes)))

    made = drawn_outlines(without, lambda sketch: on_sketch(without, sketch), with_photos)
    how = "embedded" if embedded else f"fitted as {counted(curves, 'curve')}"
    note = f"{counted(len(page.parts), 'photograph')} in it {how}"
    facts = {**made.facts, "interrupted": made.interrupted or interrupted}
    return replace(made, notes=[*made.notes, note], facts=facts)


def _of_pixels(task: Task, rgb: np.ndarray) -> Task:
    """The work on other pixels (H, W, 3), for a picture of the same size."""
    target = Picture(rgb, None, task.target.source, task.target.sha256)
    return replace(task, target=target, quick_photos={})


def _photo(task: Task, page: Page, part: PhotoPart, curves: int) -> Made:
    """The curves fitted to a part, over a background, in px of its window."""
    own = _of_pixels(task, np.ascontiguousarray(page.picture[part.window]))
    request = replace(
        task.request,
        style=PHOTO,
        shading=NONE,
        artwork=ArtworkSettings(),
        settings=task.request.settings.with_(curves=curves),
        weights=None if part.rectangular else Mask(part.mask.astype(np.float32), NAME, ""),
    )
    return fitted_photo(replace(own, picture=own.target, request=request))


def _image(page: Page, part: PhotoPart) -> EmbeddedImage:
    """The picture of a part in the smaller of a PNG and a JPEG file."""
    height, width = part.mask.shape
    image = Image.fromarray(np.rint(255.0 * page.picture[part.window]).astype(np.uint8))
    files = [io.BytesIO() for _ in range(2)]
    image.save(files[0], "PNG", optimize=True)
    image.save(files[1], "JPEG", quality=JPEG_QUALITY, subsampling=0, optimize=True)
    data = min((file.getvalue() for file in files), key=len)
    return EmbeddedImage(page.flat.shape[1::-1], part.left, part.top, width, height, data)


def _recoloured(page: Page, shapes: list[Shape]) -> list[Shape]:
    """The shapes, in a part's mean colour where they have the fill that stood for it still: specks at its edge, and
    those without a photo where there was no time.
    """
    for part in page.parts:
        red, green, blue = np.rint(255.0 * page.picture[part.window][part.mask].mean(axis=0)).astype(int).tolist()
        own = _box_of(part)
        for index, shape in enumerate(shapes):
            if not _is_near(shape, part):
                continue
            box = _box(shape)
            if np.abs(box - np.clip(box, own[[0, 1, 0, 1]], own[[2, 3, 2, 3]])).max() <= FRAME:
                shapes[index] = replace(shape, fill=(red, green, blue, 255))
    return shapes


def _box_of(part: PhotoPart) -> np.ndarray:
    """(4,) left, top, right and bottom in px."""
    rows, columns = part.window
    return np.array([columns.start, rows.start, columns.stop, rows.stop], float)


def _shape_of(drawing: Drawing, part: PhotoPart) -> int:
    """The number of the shape that stands for a part."""
    own = _box_of(part)
    common = [_in_common(own, _box(shape)) if _is_near(shape, part) else 0.0 for shape in drawing.shapes]
    if max(common, default=0.0) < LEAST_COMMON:
        raise PartIsLost
    return int(np.argmax(common))


def _is_near(shape: Shape, part: PhotoPart) -> bool:
    """Whether a shape is in about the fill that stands for a part."""
    return shape.gradient is None and bool(np.abs(np.array(shape.fill[:3]) - part.stand_in).max() <= NEAR)


def _box(shape: Shape) -> np.ndarray:
    cubics, _ = pieces_of_rings(shape.oriented())
    return np.concatenate([cubics.min(axis=(0, 1)), cubics.max(axis=(0, 1))])


def _in_common(first: np.ndarray, second: np.ndarray) -> float:
    """The area of two boxes that is in both, of that which is in either."""

    def area(box: np.ndarray) -> float:
        return float(np.maximum(box[2:] - box[:2], 0.0).prod())

    shared = area(np.concatenate([np.maximum(first[:2], second[:2]), np.minimum(first[2:], second[2:])]))
    return shared / (area(first) + area(second) - shared)


def _with_photo(page: Page, shape: Shape, part: PhotoPart, photo: Scene | EmbeddedImage) -> Shape:
    """A shape with a photo, on the page's canvas or as curves in px of the part, in place of the fill that stood for
    it.
    """
    height, width = part.mask.shape
    box = Rectangle(float(part.left), float(part.top), float(width), float(height))
    ground = 255.0 * page.picture[part.window][part.mask].mean(axis=0)
    if isinstance(photo, Scene):
        assert photo.background is not None  # that of an opaque picture
        ground = 255.0 * np.array(photo.background)
        rows, columns = page.flat.shape[:2]
        points = photo.points + np.array([part.left, part.top], np.float32)
        photo = replace(photo, points=points, background=None, width=columns, height=rows)
    red, green, blue = (round(value) for value in ground.tolist())
    outlines = (box,) if part.rectangular else shape.outlines
    return replace(shape, fill=(red, green, blue, 255), outlines=outlines, name=NAME, shading=photo)
