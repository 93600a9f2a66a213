"""Whether a photo would be nearer to a picture than its drawing, by a quick fit of as many bytes to a small copy."""

from __future__ import annotations

from cubicsplat_cli.evaluate.layers import of_scene, of_values
from cubicsplat_cli.evaluate.metrics import psnr_db
from cubicsplat_cli.files.load import resize_picture
from cubicsplat_cli.pipeline.task import Made, Task
from cubicsplat_cli.scene import Scene

# Px of the longer side: of the copy that is fitted, and of the one on which both are judged, where fine lines count.
SIDE, JUDGED_SIDE = 192, 1024
ENOUGH_DB = 40.0  # of a drawing that has lost nothing that people see
STEPS = 300
BYTES_PER_CURVE = 170.0  # of the photo style at its usual precision
FEWEST, MOST = 8, 512  # curves of the quick fit; the photo has no more either, unless that is asked for
# Shapes can be edited, so the curves must be better by what is plain to see.
MARGIN_DB = 1.0
SKETCH_DB = 2.0  # that fitted outlines are better than polygons


class PhotoIsNearer(Exception):
    """A drawing is not worth finishing; the text says why, as `photo_is_nearer` does."""


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

    judged, threads = resize_picture(task.target, JUDGED_SIDE), task.request.settings.threads

    def level(scene: Scene, blur: float = 0.0) -> float | None:
        layer = of_scene(scene, judged.width, judged.height, made.samples, threads)
        if blur:
            from scipy import ndimage

            layer = of_values(ndimage.gaussian_filter(layer.rows(0, judged.height), (blur, blur, 0.0), mode="nearest"))
        return psnr_db(judged, layer, threads)

    if made.scene is None:
        return None
    drawn = level(made.scene, made.blur * judged.width / task.target.width)
    if drawn is None or drawn >= ENOUGH_DB:
        return None
    size = len(made.write(task.title, task.comment()).encode())
    curves = round(min(max(size / BYTES_PER_CURVE, FEWEST), MOST))
    quick = fit(resize_picture(task.target, SIDE).target(), task.settings().with_(curves=curves, steps=STEPS))
    if quick.interrupted:
        raise KeyboardInterrupt
    fitted = level(quick.scene)
    if fitted is not None and fitted <= drawn + margin_db:
        return None
    return f"a quick photo of {curves} curves has {fitted:.1f} dB, drawn it has {drawn:.1f} dB"
