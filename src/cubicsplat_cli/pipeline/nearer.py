"""Whether a photo would be nearer to a picture than its drawing, by a quick fit of as many bytes to a small copy."""

from __future__ import annotations

from cubicsplat_cli.evaluate.images import of_scene, of_values
from cubicsplat_cli.evaluate.metrics import psnr_db
from cubicsplat_cli.files.load import resize_picture
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.scene import Scene

# Px of the longer side: of the copy that is fitted, and of the one on which both are judged, where fine lines count.
SIDE, JUDGED_SIDE = 192, 1024
ENOUGH_DB = 40.0  # of a drawing that has lost nothing that people see
FAR_DB = 22.0  # a mean error of 8 % of full scale, plain to see
STEPS = 300
BYTES_PER_CURVE = 170.0  # of the photo style at its usual precision
FEWEST, MOST = 8, 512  # curves of the quick fit; the photo has no more either, unless that is asked for
# Shapes can be edited, so the curves must be better by what is plain to see.
MARGIN_DB = 1.0
SKETCH_DB = 2.0  # that fitted outlines are better than polygons


class PhotoIsNearer(Exception):
    """A drawing is not worth finishing; the text says why, as `photo_is_nearer` does."""


def level_db(task: Task, scene: Scene | None, samples: int, blur: float = 0.0) -> float | None:
    """PSNR of a scene against what is fitted, at most JUDGED_SIDE px; None where they are alike, or there is no scene.

    samples: edges per cubic. blur: px of the target by which the scene is blurred first.
    """
    if scene is None:
        return None
    judged, threads = resize_picture(task.target, JUDGED_SIDE), task.request.settings.threads
    layer = of_scene(scene, judged.width, judged.height, samples, threads)
    if blur:
        from scipy import ndimage

        sigma = blur * judged.width / task.target.width
        layer = of_values(ndimage.gaussian_filter(layer.rows(0, judged.height), (sigma, sigma, 0.0), mode="nearest"))
    return psnr_db(judged, layer, threads)


def check_worth_finishing(task: Task, sketch: Made) -> None:
    """Raises PhotoIsNearer where not even fitted outlines would bring a drawing near enough, and what a fit raises."""
    reason = photo_is_nearer(task, sketch, MARGIN_DB + SKETCH_DB)
    if reason is not None:
        raise PhotoIsNearer(reason)


def photo_is_nearer(task: Task, made: Made, margin_db: float = MARGIN_DB) -> str | None:
    """Why the photo style suits the picture better than its drawing does, by so many dB; None where it does not.

    Raises what a fit raises, and KeyboardInterrupt.
    """
    from cubicsplat_cli.photo import fit

    drawn = level_db(task, made.scene, made.samples, made.blur)
    if drawn is None or drawn >= ENOUGH_DB:
        return None
    size = len(made.write(task.title, task.comment()).encode())
    curves = round(min(max(size / BYTES_PER_CURVE, FEWEST), MOST))
    quick = fit(resize_picture(task.target, SIDE).target(), task.settings().with_(curves=curves, steps=STEPS))
    if quick.interrupted:
        raise KeyboardInterrupt
    fitted = level_db(task, quick.scene, made.samples)
    if fitted is not None and fitted <= drawn + margin_db:
        return None
    near = "is identical" if fitted is None else f"has {fitted:.1f} dB"
    return f"a quick photo of {curves} curves {near}, drawn it has {drawn:.1f} dB"
