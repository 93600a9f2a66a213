"""The paper's tables, measured here, beside the published figures."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from cubicsplat_cli.bench import published
from cubicsplat_cli.bench.memory import memory
from cubicsplat_cli.bench.quality import configuration_name, means
from cubicsplat_cli.bench.runs import Fit, Run, Runs
from cubicsplat_cli.bench.step import total_steps, wait_for_gpu
from cubicsplat_cli.bench.synthetic import synthetic_picture
from cubicsplat_cli.evaluate.comparison import compare_with
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.photo.phases import raster_of
from cubicsplat_cli.photo.threads import one_torch_thread
from cubicsplat_cli.photo.trainer import Trainer
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.tables import number, text_table

MODES = ("open", "closed")
COUNTS = (256, 512, 1024)
WARMUP, REPEATS = 40, 11
# Five points of each thing that grows; the others stay at the middle one.
GROWING_CURVES = (128, 512, 2048, 8192, 32_768)
GROWING_SIZES = ((192, 128), (384, 256), (768, 512), (1536, 1024), (3072, 2048))
GROWING_SAMPLES = (4, 8, 16, 32, 64)
USUAL_CURVES, USUAL_SIZE, USUAL_SAMPLES = 512, (768, 512), 12


@dataclass(frozen=True)
class StepTimes:
    """Medians in milliseconds: drawing, the way back (drawing and way back, less drawing), a whole training step."""

    forward_ms: float
    backward_ms: float
    step_ms: float


@dataclass(frozen=True)
class Growth:
    """How a step's time grows with one thing: the points, and the exponent of the power that fits them best."""

    what: str
    mode: str
    values: tuple[int, ...]
    step_ms: tuple[float, ...]
    exponent: float


@dataclass(frozen=True)
class Magnified:
    """One picture's fit at its size and at a multiple: PSNR in dB of the file and of the engine; None: identical."""

    picture: str
    mode: str
    pixels_across: int
    svg_db: float | None
    svg_change_db: float | None
    engine_db: float | None
    engine_change_db: float | None


def step_times(size: tuple[int, int], settings: FitSettings) -> StepTimes:
    """Of a fit of the drawn picture of this size, WARMUP steps after its start."""
    settings = settings.with_(steps=max(settings.steps, total_steps(WARMUP, 3 * REPEATS, settings.recipe.finish)))
    trainer = Trainer(synthetic_picture(*size), settings)
    engine, goal = trainer.engine, trainer.goal
    with one_torch_thread():
        for _ in range(WARMUP):
            trainer.advance()
        raster = raster_of(trainer.schedule.phase(trainer.progress()), trainer.settings)
        forward = _median_ms(lambda: engine.render(trainer.curves, raster))
        both = _median_ms(lambda: engine.gradients(trainer.curves, raster, target=goal))
        whole = _median_ms(trainer.advance)
    engine.close()
    return StepTimes(forward, max(0.0, both - forward), whole)


def _median_ms(call: Callable[[], object]) -> float:
    seconds = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        call()
        wait_for_gpu()
        seconds.append(time.perf_counter() - started)
    return 1e3 * statistics.median(seconds)


def exponent(values: Sequence[float], times: Sequence[float]) -> float:
    """The power of `values` that fits `times` best, by least squares of logarithms."""
    return float(np.polyfit(np.log(values), np.log(times), 1)[0])


def growths(modes: Sequence[str], fit: Mapping[str, Any], tell: Callable[[str], None]) -> list[Growth]:
    """Of the curves, the pixels and S, each with the two others as they usually are."""
    found = []
    for mode in modes:
        points = {
            "curves": [(count, USUAL_SIZE, count, USUAL_SAMPLES) for count in GROWING_CURVES],
            "pixels": [(w * h, (w, h), USUAL_CURVES, USUAL_SAMPLES) for w, h in GROWING_SIZES],
            "S": [(samples, USUAL_SIZE, USUAL_CURVES, samples) for samples in GROWING_SAMPLES],
        }
        for what, rows in points.items():
            times = []
            for value, size, curves, samples in rows:
                # Without a tolerance every cubic has S edges, as in the paper.
                settings = FitSettings.from_preset(mode=mode, curves=curves, samples=samples, tolerance=0.0, **fit)
                times.append(step_times(size, settings).step_ms)
                tell(f"{mode}, {value} {what}: {times[-1]:.2f} ms a step")
            values = tuple(row[0] for row in rows)
            found.append(Growth(what, mode, values, tuple(times), exponent(values, times)))
    return found


def magnified(runs: Runs, fits: Sequence[Fit], threads: int | None) -> list[Magnified]:
    """Each fitted picture, drawn so many times as large and averaged back."""
    paths = {fit.path.name: fit.path for fit in fits}
    return [_magnified(run, svg, paths[run.picture], threads) for run, svg in runs.done]


def _magnified(run: Run, svg: bytes, path: Path, threads: int | None) -> Magnified:
    picture = load_picture(path)
    factor = published.MAGNIFICATION
    found = compare_with(picture, str(path), svg, f"{run.picture}.svg", is_svg=True, scale=factor, threads=threads)
    assert found.scale is not None
    engine = found.scale.engine
    return Magnified(
        run.picture,
        run.mode,
        factor * picture.width,
        found.scale.file.native.psnr_db,
        found.scale.file.change_db,
        None if engine is None else engine.native.psnr_db,
        None if engine is None else engine.change_db,
    )


def steps_table(times: Mapping[str, StepTimes], *, markdown: bool) -> str:
    """Table 1. times: by mode."""
    rows = []
    for mode, found in times.items():
        forward, backward = published.STEP_MS[mode]
        rows.append((mode, *(number(v, 2) for v in asdict(found).values()), f"{forward:.2f}", f"{backward:.2f}"))
    header = ("mode", "forward ms", "backward ms", "whole step ms", "published forward", "backward")
    return text_table(header, rows, markdown=markdown)


def growth_table(found: Sequence[Growth], *, markdown: bool) -> str:
    """The milliseconds of a step at each point, and the exponent."""
    rows = [
        (
            f"{g.what}, {g.mode}",
            *(f"{v}: {ms:.1f}" for v, ms in zip(g.values, g.step_ms, strict=True)),
            f"{g.exponent:.2f}",
        )
        for g in found
    ]
    return text_table(("ms a step by", *(["point: ms"] * 5), "exponent"), rows, markdown=markdown)


def quality_table(runs: Runs, *, markdown: bool) -> str:
    """Table 2: means of the folder, with the published ones of DIV2K."""
    rows = []
    for (mode, count), (ssim, level, minutes) in published.QUALITY.items():
        of = runs.of(configuration_name(mode, count))
        if of:
            ours = means(of)
            size = ours["bytes"]
            rows.append(
                (
                    f"{mode} {count}", str(len(of)), number(ours["ssim"], 3), number(ours["psnr_db"], 2),
                    number(ours["own_psnr_db"], 2), number(None if size is None else size / 1000, 1),
                    number(ours["seconds"], 1), f"{ssim:.3f}", f"{level:.2f}", f"{60 * minutes:.0f}",
                )
            )  # fmt: skip
    header = ("", "pictures", "SSIM", "SVG dB", "own dB", "kB", "s", "published SSIM", "dB", "s")
    return text_table(header, rows, markdown=markdown)


def magnified_table(found: Sequence[Magnified], *, markdown: bool) -> str:
    """A row for each picture and mode."""
    rows = [
        (
            f"{m.picture}, {m.mode}", str(m.pixels_across), number(m.svg_db, 2), number(m.svg_change_db, 3, sign=True),
            number(m.engine_db, 2), number(m.engine_change_db, 3, sign=True),
        )
        for m in found
    ]  # fmt: skip
    header = ("picture", "px across", "file dB", "magnified", "engine dB", "magnified")
    return text_table(header, rows, markdown=markdown)


def large_table(runs: Runs, *, markdown: bool) -> str:
    """A row for each picture; the memory is the process's peak so far."""
    peak = memory().peak
    rows = [
        (
            run.picture, str(run.curves), number(run.psnr_db, 2), number(run.own_psnr_db, 2), number(run.seconds, 0),
            number(None if peak is None or run.cached else peak / 1e6, 0), f"{published.MANY_DB:.2f}",
            str(published.MANY_MB),
        )
        for run, _ in runs.done
    ]  # fmt: skip
    header = ("picture", "curves", "SVG dB", "own dB", "s", "peak MB", "published dB", "MB")
    return text_table(header, rows, markdown=markdown)
