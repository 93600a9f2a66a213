"""Pages: drawings with photographs in them. Each photograph is a shape that holds curves fitted to it, or an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from PIL import Image

from cubicsplat_cli.artwork.channels import largest
from cubicsplat_cli.artwork.geometry.outlines import Rectangle
from cubicsplat_cli.artwork.input.condition import BLOCK
from cubicsplat_cli.artwork.limits import blocks_of, reduction
from cubicsplat_cli.artwork.photo_parts import FRAME, Page, PhotoPart, Window, page_of
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.artwork.structure import boxes_of
from cubicsplat_cli.artwork.style import PHOTO
from cubicsplat_cli.files.decode import Compression
from cubicsplat_cli.files.load import with_target
from cubicsplat_cli.files.weights import Mask
from cubicsplat_cli.files.write import encoded
from cubicsplat_cli.formatting import counted
from cubicsplat_cli.pipeline.artwork import drawn_outlines
from cubicsplat_cli.pipeline.photo import fitted_photo
from cubicsplat_cli.pipeline.task import DrawingGivenUp, Made, Task
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.request import IMAGE, NONE
from cubicsplat_cli.scene import EmbeddedImage, Scene
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.scene.paint import Rgba

SAMPLE = 64  # px a side of what is drawn of a part, to see if that suits it; a photo's takes 2 s on average
JPEG_QUALITY = 92  # of an embedded photo: hardly anybody sees what it loses
NAME = "photo"  # of the shapes and their masks
NEAR = 64  # levels between the placeholder of a part and the fill of its shape, at most; other fills differ by far more
LEAST_COMMON = 0.5  # intersection over union of the boxes of a part and its shape


def page_in(task: Task, suits_photo: Callable[[Task], bool]) -> Page | None:
    """Return the page that a picture shows; None if it shows none, or the request excludes pages. suits_photo: returns
    whether a picture is better as a photo than drawn, given the task of it alone.
    """
    if not task.request.may_hold_photos or task.recorder is not None:
        return None
    target = task.pixels
    factor = reduction(*target.shape[:2])
    compression = task.target.compression if factor == 1 else None
    if factor > 1:
        target = np.ascontiguousarray(blocks_of(with_channels(target, 4), factor)[..., : target.shape[2]])

    def suits(picture: np.ndarray, part: PhotoPart) -> bool:
        return suits_photo(_of_pixels(task, picture[_sample(picture, part)], compression))

    return page_of(target, suits)


def _sample(picture: np.ndarray, part: PhotoPart) -> Window:
    """Return the window of at most SAMPLE px a side, within that of a part, with the most change in the part."""
    steps = largest(np.abs(np.gradient(picture[part.window], axis=(0, 1))).sum(axis=0)) * part.mask
    change = ndimage.uniform_filter(steps, (SAMPLE, SAMPLE))
    ends, whole = [], 2 * BLOCK  # of a JPEG's chroma at half the size, so that its compression can be repeated
    for middle, side in zip(np.unravel_index(int(change.argmax()), change.shape), part.window, strict=True):
        start = side.start + int(np.clip(middle - SAMPLE // 2, 0, max(0, side.stop - side.start - SAMPLE)))
        ends.append(slice(start // whole * whole, min(start + SAMPLE, side.stop)))
    return ends[0], ends[1]


def drawn_page(task: Task, page: Page, on_sketch: Callable[[Task, Made], None]) -> Made:
    """Draw a page with its photographs.

    on_sketch: is given the task of the page without photographs, and a first version of a drawing of very many pieces.
    Raises DrawingGivenUp if a photograph has no shape, and the errors of `on_sketch`.
    """
    own_size = page.flat.shape == task.pixels.shape
    without = _of_pixels(task, page.flat, task.target.compression if own_size else None)
    pixels = sum(part.size for part in page.parts)
    curves = task.settings().for_size(pixels, 1).curves
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
            photo = _photo(task, page, part, max(1, round(curves * part.size / pixels)))
            interrupted |= photo.interrupted
            assert isinstance(photo.scene, Scene)
            shapes[index] = _with_photo(page, shapes[index], part, photo.scene)
        return replace(drawing, shapes=tuple(_recoloured(page, shapes)))

    made = drawn_outlines(without, lambda sketch: on_sketch(without, sketch), with_photos)
    how = "embedded" if embedded else f"fitted as {counted(curves, 'curve')}"
    made = made.with_note(f"{counted(len(page.parts), 'photograph')} in it {how}")
    return replace(made, interrupted=made.interrupted or interrupted)


def _of_pixels(task: Task, pixels: np.ndarray, compression: Compression | None = None) -> Task:
    """Return the task with other pixels, (H, W, 3) or premultiplied (H, W, 4), as its target, compressed like that."""
    target = replace(with_target(task.target, pixels.copy()), notes=(), full_size=None, compression=compression)
    return replace(task, target=target, results={})


def _photo(task: Task, page: Page, part: PhotoPart, curves: int) -> Made:
    """Fit curves to a part, over a background, in px of its window."""
    own = _of_pixels(task, page.picture[part.window])
    weights = None if part.rectangular else Mask(part.mask.astype(np.float32), NAME, "")
    fit = task.request.settings.with_(curves=curves)
    request = replace(task.request, style=PHOTO, shading=NONE, artwork=ArtworkSettings(), settings=fit, weights=weights)
    return fitted_photo(replace(own, picture=own.target, request=request))


def _image(page: Page, part: PhotoPart) -> EmbeddedImage:
    """Return the picture of a part in the smaller of a PNG and a JPEG file."""
    height, width = part.mask.shape
    image = Image.fromarray(np.rint(255.0 * page.picture[part.window]).astype(np.uint8))
    png = encoded(image, "PNG", optimize=True)
    jpeg = encoded(image, "JPEG", quality=JPEG_QUALITY, subsampling=0, optimize=True)
    return EmbeddedImage(page.flat.shape[1::-1], part.left, part.top, width, height, min(png, jpeg, key=len))


def _recoloured(page: Page, shapes: list[Shape]) -> list[Shape]:
    """Return the shapes, specks at a part's edge and shapes whose photo was not made in time in its mean colour."""
    for part in page.parts:
        left, top, right, bottom = _box_of(part)
        fill = _fill(_mean_colour(page, part))
        for index, (shape, box) in enumerate(zip(shapes, boxes_of(shapes), strict=True)):
            inside = np.clip(box, (left, top, left, top), (right, bottom, right, bottom))
            if _is_near(shape, part) and np.abs(box - inside).max() <= FRAME:
                shapes[index] = replace(shape, fill=fill)
    return shapes


def _mean_colour(page: Page, part: PhotoPart) -> np.ndarray:
    """Return the mean colour (3,) of a part in levels."""
    return np.asarray(255.0 * page.picture[part.window][part.mask].mean(axis=0))


def _fill(levels: np.ndarray) -> Rgba:
    red, green, blue = (round(level) for level in levels.tolist())
    return red, green, blue, 255


def _box_of(part: PhotoPart) -> np.ndarray:
    """Return left, top, right and bottom of a part in px, (4,)."""
    rows, columns = part.window
    return np.array([columns.start, rows.start, columns.stop, rows.stop], float)


def _shape_of(drawing: Drawing, part: PhotoPart) -> int:
    """Return the number of a part's shape: its box has most in common. Raises DrawingGivenUp without one."""
    own, boxes = _box_of(part), boxes_of(drawing.shapes)
    both = np.hstack([np.maximum(own[:2], boxes[:, :2]), np.minimum(own[2:], boxes[:, 2:])])
    shared, one, others = (np.maximum(box[..., 2:] - box[..., :2], 0.0).prod(axis=-1) for box in (both, own, boxes))
    common = shared / (one + others - shared) * [_is_near(shape, part) for shape in drawing.shapes]
    if common.max(initial=0.0) < LEAST_COMMON:
        raise DrawingGivenUp
    return int(common.argmax())


def _is_near(shape: Shape, part: PhotoPart) -> bool:
    """True if the fill of a shape is about the placeholder of a part."""
    return shape.gradient is None and bool(np.abs(np.array(shape.fill[:3]) - part.stand_in).max() <= NEAR)


def _with_photo(page: Page, shape: Shape, part: PhotoPart, photo: Scene | EmbeddedImage) -> Shape:
    """Return a shape with a photo for its placeholder: an image on the page's canvas, or curves in px of the part."""
    height, width = part.mask.shape
    box = Rectangle(float(part.left), float(part.top), float(width), float(height))
    ground = _mean_colour(page, part)
    if isinstance(photo, Scene):
        assert photo.background is not None  # a fit to an opaque picture has one
        ground = 255.0 * np.array(photo.background)
        rows, columns = page.flat.shape[:2]
        points = photo.points + np.array([part.left, part.top], np.float32)
        photo = replace(photo, points=points, background=None, width=columns, height=rows)
    outlines = (box,) if part.rectangular else shape.outlines
    return replace(shape, fill=_fill(ground), outlines=outlines, stroke=None, name=NAME, shading=photo)
