"""Shading within clean outlines: objects, silhouettes, clips, files that all renderers draw alike."""

from __future__ import annotations

import math
import re
from dataclasses import replace

import numpy as np
import pytest
from conftest import ctrl_c
from image_files import recoded
from PIL import Image
from skimage import data
from skimage.color import deltaE_ciede2000, rgb2lab
from test_svg_viewers import AGREEMENT_DB, in_chromium

from benchmarks.artwork.pixels import psnr
from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.input.condition import Condition
from cubicsplat_cli.artwork.regularities.regularities import regularised
from cubicsplat_cli.artwork.scene import picture_of
from cubicsplat_cli.artwork.shading import objects_of, silhouettes, surfaces_of
from cubicsplat_cli.artwork.shapes import Drawing, scaled_drawing
from cubicsplat_cli.artwork.vectorize import prepare
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.images import of_scene
from cubicsplat_cli.evaluate.perceptual import metric
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.export.formats import exported
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.pipeline.shaded import PX_PER_CURVE, shade_objects, shade_surfaces, shaded_objects
from cubicsplat_cli.progress import Work, under_way
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import EngineScene, Pass
from cubicsplat_cli.raster.engines import scene_arrays
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import LayeredScene, Scene
from cubicsplat_cli.scene.arrays import with_channels
from cubicsplat_cli.settings import FitSettings, Mode
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.scene_reader import read_svg

SIDE, RADIUS = 72, 26.0
QUICK = FitSettings.from_preset(steps=120, threads=1)


def shares(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """The coverage of a disc's pixels, from the distance to its rim."""
    return np.clip(RADIUS + 0.5 - np.hypot(x - SIDE / 2, y - SIDE / 2), 0.0, 1.0)


def ball(spots: int = 2) -> np.ndarray:
    """(SIDE, SIDE, 4) a ball on nothing, of a shading that is no gradient, and on it a dark square; premultiplied."""
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    light = np.zeros((SIDE, SIDE))
    for cx, cy in ((26, 24), (50, 46), (48, 22), (20, 44))[:spots]:
        light += np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 220.0)
    colour = np.stack([200 + 50 * light, 90 + 120 * light, 40 + 30 * light], axis=2) / 255.0
    colour[40:52, 24:36] = 0.1, 0.1, 0.3
    alpha = shares(x, y)[..., None]
    return np.concatenate([np.clip(colour, 0, 1) * alpha, alpha], axis=2).astype(np.float32)


def image_of_ball(spots: int = 2) -> np.ndarray:
    """(SIDE, SIDE, 4) uint8 the same, with straight colours."""
    pixels = ball(spots)
    straight = pixels[..., :3] / np.maximum(pixels[..., 3:], 1e-6)
    return np.rint(255.0 * np.concatenate([straight, pixels[..., 3:]], axis=2)).astype(np.uint8)


@pytest.fixture(scope="module")
def drawing() -> Drawing:
    objects = shaded_objects(ball())
    assert objects is not None
    return shade_objects(objects, QUICK)


@pytest.fixture(scope="module")
def svg(drawing) -> str:
    return write_drawing(drawing, title="ball", comment="c")


def levels_off(picture: np.ndarray, text: str) -> np.ndarray:
    """(H, W) mean levels by which cairosvg's picture is off, over white."""
    pixels = rerender(text.encode(), picture.shape[1], picture.shape[0]).pixels / 255.0
    over = pixels[..., :3] * pixels[..., 3:] + 1.0 - pixels[..., 3:]
    return 255.0 * np.abs(over - (picture[..., :3] + 1.0 - picture[..., 3:])).mean(axis=2)


def unshaded(drawing: Drawing) -> str:
    shapes = tuple(replace(shape, shading=None) for shape in drawing.shapes)
    return write_drawing(replace(drawing, shapes=shapes), title="", comment="")


def test_objects_end_at_edges_and_not_where_shading_changes():
    labels = objects_of(255.0 * ball())
    assert labels.max() == 2  # nothing, the ball, the square
    assert len(np.unique(labels[[20, 36, 60], [24, 60, 40]])) == 1
    assert labels[46, 30] != labels[20, 24] != labels[2, 2]


def test_a_small_hole_is_no_part_of_what_is_around_it():
    levels = 255.0 * ball()
    levels[22:27, 40:45] = 0.0  # too small for pixels away from its edges
    labels = objects_of(levels)
    assert labels[24, 42] == labels[2, 2] != labels[24, 52]
    assert len(np.unique(labels)) == 3
    assert not silhouettes(levels, labels).levels[24, 42].any()


def test_silhouettes_keep_the_shares_of_the_edges():
    levels = 255.0 * ball()
    flat = silhouettes(levels, objects_of(levels)).levels
    y, x = np.mgrid[:SIDE, :SIDE] + 0.5
    assert np.abs(flat[..., 3] / 255.0 - shares(x, y)).max() < 0.03
    assert len(np.unique(flat[flat[..., 3] == 255.0].round(), axis=0)) < 60  # two fills, and the edge between them


def test_a_thin_line_stays_an_object_of_its_own():
    levels = np.full((40, 40, 4), 255.0)
    levels[:, 18:21, :3] = 0.0, 120.0, 60.0
    levels[10:30, 14:25, :3] = 0.0, 120.0, 60.0
    flat = silhouettes(levels, objects_of(levels)).levels
    assert np.abs(flat[3, 19] - flat[20, 19]).max() < 1.0
    assert np.abs(flat[3, 19] - flat[3, 5]).max() > 40.0


def test_shading_brings_a_drawing_near_as_far_as_its_edges(drawing, svg):
    shaded = [shape for shape in drawing.shapes if shape.shading is not None]
    assert len(drawing.shapes) == 2
    assert [shape.name for shape in shaded] == ["orange"]
    near, far = levels_off(ball(), svg), levels_off(ball(), unshaded(drawing))
    assert near.mean() < 0.5 * far.mean()
    assert near.max() < 32.0


def test_the_group_is_named_and_lies_beneath_what_covers_it(svg):
    order = re.findall(r'<(?:g|circle|rect|clipPath) id="([^"]*)"', svg)
    assert order[:2] == ["orange-outline", "orange"]
    assert len(order) == 3
    assert 'clip-path="url(#orange-outline)"' in svg


def test_a_file_reads_back_as_it_was_written(drawing, svg):
    read = read_drawing(svg)
    assert write_drawing(read, title="ball", comment="c") == svg
    curves = [shape.shading.curves for shape in read.shapes if shape.shading is not None]
    assert curves == [shape.shading.curves for shape in drawing.shapes if shape.shading is not None]


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("url(#orange-outline)", "url(#other)"),
        ('transform="scale(', 'transform="scale(3'),
        ('opacity=".999"', 'opacity=".5"'),
        ("z", "a1 1 0 0 1 2 2z"),
    ],
)
def test_what_is_no_shading_of_ours_is_refused(svg, old, new):
    group = svg.index("<clipPath")
    with pytest.raises(InputError, match="line"):
        read_drawing(svg[:group] + svg[group:].replace(old, new, 1))


def test_a_drawing_with_shading_is_no_scene_of_curves(svg):
    with pytest.raises(InputError, match="read_drawing"):
        read_svg(svg)


def test_cairosvg_and_resvg_draw_it_alike(svg):
    for side in (SIDE, 4 * SIDE):
        drawn = [rerender(svg.encode(), side, side, renderer=name).pixels for name in ("cairosvg", "resvg")]
        assert psnr(*drawn) > AGREEMENT_DB


@pytest.mark.parametrize(("renderer", "levels"), [("resvg", 1), ("cairosvg", 23)])
def test_edges_are_those_of_the_shape(drawing, svg, renderer, levels):
    shaded, plain = (
        rerender(text.encode(), SIDE, SIDE, renderer=renderer).pixels[..., 3].astype(int)
        for text in (svg, unshaded(drawing))
    )
    assert np.abs(shaded - plain).max() <= levels


@pytest.mark.slow
def test_chromium_draws_it_alike(svg, browser, tmp_path):
    (tmp_path / "x.svg").write_text(svg, encoding="utf-8")
    shown = in_chromium(browser, tmp_path / "x.svg", SIDE, SIDE)
    assert psnr(shown, rerender(svg.encode(), SIDE, SIDE).pixels) > AGREEMENT_DB


def test_the_engine_draws_the_layers_as_renderers_do(drawing, svg):
    scene = picture_of(drawing)
    assert isinstance(scene, LayeredScene)
    assert scene.curves == sum(1 + (s.shading.curves if s.shading else 0) for s in drawing.shapes)
    own = of_scene(scene, SIDE, SIDE, 24, 1).rows(0, SIDE)
    straight = np.concatenate([own[..., :3] / np.maximum(own[..., 3:], 1e-6), own[..., 3:]], axis=2)
    drawn = rerender(svg.encode(), SIDE, SIDE).pixels
    assert psnr(np.rint(255.0 * np.clip(straight, 0, 1)).astype(np.uint8), drawn) > AGREEMENT_DB


def test_shading_grows_with_its_drawing(drawing):
    large = scaled_drawing(drawing, 2 * SIDE, 2 * SIDE)
    small, big = (of_scene(picture_of(each), SIDE, SIDE, 24, 1).rows(0, SIDE) for each in (drawing, large))
    assert np.abs(small - big).max() < 0.02


def test_a_ground_lies_behind_the_curves_of_the_engine():
    ground = np.random.default_rng(0).random((8, 8, 3), np.float32)
    points = np.array([[[0, 0], [3, 0], [6, 0], [9, 0], [6, 3], [3, 6], [0, 9], [0, 6], [0, 3]]], np.float32)
    colours, opacities = np.array([[1, 0, 0]], np.float32), np.array([0.25], np.float32)
    scene = Scene(Mode.CLOSED, 8, 8, points, colours, opacities, np.zeros(1, np.float32), (0.0, 1.0, 0.0))
    engine = CpuEngine(1)
    engine.ground = ground
    drawn = engine.render(scene_arrays(scene), RasterSettings("exact", 1.0, 8, 0.0))
    assert drawn[7, 7] == pytest.approx(ground[7, 7])
    assert drawn[1, 1] == pytest.approx(0.75 * ground[1, 1] + (0.25, 0.0, 0.0), abs=1e-6)


def test_the_engine_charges_errors_by_the_metric_of_their_pixels():
    draw, size, count = np.random.default_rng(0), 21, 4
    points, colours, target = (
        draw.random(shape).astype(np.float32) for shape in ((count, 9, 2), (count, 3), (size, size, 3))
    )
    roots = draw.normal(size=(size, size, 3, 3))
    seen = roots @ roots.swapaxes(2, 3)
    engine, exact = CpuEngine(1), RasterSettings("exact", 1.0, 12)
    rows = [[seen[..., i, j] for i, j in row] for row in (((0, 0), (1, 1), (2, 2)), ((0, 1), (0, 2), (1, 2)))]
    engine.metric = np.ascontiguousarray(np.moveaxis(np.array(rows), 1, 3), np.float32)

    def scene(colours: np.ndarray, kept: np.ndarray) -> EngineScene:
        own, opacities = np.ascontiguousarray(20.0 * points[kept]), np.full(len(kept), 0.7, np.float32)
        black, fills = (0.0, 0.0, 0.0), np.ascontiguousarray(colours[kept])
        return EngineScene(Mode.CLOSED, size, size, own, fills, opacities, 0.0 * opacities, black)

    everything = np.arange(count)
    error = (engine.render(scene(colours, everything), exact) - target).astype(float)
    loss, found = engine.gradients(scene(colours, everything), exact, target=target, importance="loo")
    assert loss == pytest.approx(np.einsum("hwi,hwij,hwj->", error, seen, error), rel=1e-5)
    for curve in range(count):
        without = engine.loss(scene(colours, np.delete(everything, curve)), exact, Pass(target))
        assert without - loss == pytest.approx(float(found["importance"][curve]), rel=1e-3, abs=1e-3)
        step = np.zeros_like(colours)
        step[curve, 2] = 0.01
        ends = [engine.loss(scene(colours + sign * step, everything), exact, Pass(target)) for sign in (1, -1)]
        assert (ends[0] - ends[1]) / 0.02 == pytest.approx(float(found["colours"][curve, 2]), rel=1e-2, abs=1e-2)


def test_the_metric_is_the_square_of_small_differences_as_they_are_seen():
    draw = np.random.default_rng(1)
    colours, step = draw.uniform(20.0, 235.0, (200, 3)), draw.normal(size=(200, 3))
    (a, b, c), (ab, ac, bc) = np.moveaxis(metric(colours), 2, 1)
    x, y, z = step.T
    square = a * x * x + b * y * y + c * z * z + 2.0 * (ab * x * y + ac * x * z + bc * y * z)
    ends = (rgb2lab((colours + sign * step) / 255.0) for sign in (0.5, -0.5))
    np.testing.assert_allclose(np.sqrt(square), deltaE_ciede2000(*ends), rtol=0.05, atol=0.02)


def test_curves_of_all_objects_have_one_opacity(drawing):
    shadings = [shape.shading for shape in drawing.shapes if shape.shading is not None]
    assert shadings
    for shading in shadings:
        assert shading.opacities == pytest.approx(0.5, abs=1.0 / 255.0)


def test_flat_pictures_and_textures_have_no_shading():
    assert shaded_objects(ball(0)) is None
    random = np.random.default_rng(0)
    assert shaded_objects(random.random((SIDE, SIDE, 3), np.float32)) is None
    grain = ball(0)
    grain[..., :3] += grain[..., 3:] * random.normal(0.0, 3.0 / 255.0, (SIDE, SIDE, 1)).astype(np.float32)
    assert shaded_objects(np.clip(grain, 0.0, grain[..., 3:])) is None


def test_a_large_picture_has_no_more_curves_than_a_copy_of_it(monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.pipeline.shaded.MOST_FITTED", SIDE**2 / 4)
    small = shade_objects(shaded_objects(ball()), QUICK)
    curves = sum(shape.shading.curves for shape in small.shapes if shape.shading is not None)
    assert 0 < curves <= math.pi * RADIUS**2 / 4 / PX_PER_CURVE
    text = write_drawing(small, title="", comment="")
    assert levels_off(ball(), text).mean() < 0.5 * levels_off(ball(), unshaded(small)).mean()


def test_soft_objects_are_shaded_where_the_style_is_chosen():
    chosen, artwork = (
        vectorize(image_of_ball(4), style=style, steps=120, threads=1, measure=False) for style in ("auto", "artwork")
    )
    assert chosen.report.style == "artwork" and chosen.report.shaded
    assert any(note.startswith("shaded within its outlines: ") for note in chosen.report.notes)
    assert not artwork.report.shaded and "clipPath" not in artwork.svg


@pytest.mark.slow
def test_photos_stay_photos_where_shading_may_be():
    photo = data.chelsea()[90:154, 140:204]
    plain, shaded = (vectorize(photo, preset="draft", threads=1, shading=how) for how in ("none", "auto"))
    assert shaded.report.style == "photo"
    assert re.findall(r'd="[^"]*"', shaded.svg) == re.findall(r'd="[^"]*"', plain.svg)


def test_the_command_shades_as_asked(run_cli, tmp_path):
    Image.fromarray(image_of_ball(4)).save(tmp_path / "ball.png")
    texts = {}
    for shading in ("none", "12"):
        out = tmp_path / f"{shading}.svg"
        given = ("--style", "artwork", "--shading", shading, "--preset", "draft", "--steps", 60, "--threads", 1)
        run_cli("vectorize", tmp_path / "ball.png", "-o", out, *given)
        texts[shading] = out.read_text()
    assert "clipPath" not in texts["none"]
    assert 1 <= texts["12"].count("<path") - 3 <= 12  # two shapes and the clip


@pytest.mark.slow
def test_a_drawing_gives_way_to_a_shaded_one_that_its_sketch_cannot_reach(monkeypatch):
    finished = []

    def finish(*given):
        finished.append(given)
        return regularised(*given)

    monkeypatch.setattr("cubicsplat_cli.artwork.vectorize.regularised", finish)
    for many, drawings in ((1000, 2), (0, 1)):  # with and without a sketch; the objects of the shaded one have no fewer
        monkeypatch.setattr("cubicsplat_cli.pipeline.artwork.MANY", many)
        finished.clear()
        made = vectorize(image_of_ball(4), style="artwork", shading=200, steps=120, threads=1, measure=False)
        assert "clipPath" in made.svg
        assert len(finished) == drawings


@pytest.mark.parametrize("shading", ["0", "many", "-3", "1.5"])
def test_shading_takes_none_auto_or_a_number(shading):
    with pytest.raises(UsageError, match="none, auto"):
        request_of({"shading": shading})


@pytest.mark.parametrize("option", [{"stacking": "cutout"}, {"colors": 3}, {"group_by": "object"}, {"curves": 9}])
def test_shading_does_not_go_with_options_of_flat_shapes(option):
    with pytest.raises(UsageError, match="leave out"):
        request_of({"shading": "20", **option})
    assert not request_of(option).may_shade


def test_programs_without_clips_get_the_shapes_alone(svg):
    data, notes = exported(svg.encode(), "xml", "the SVG", tolerance=0.05)
    assert data.count(b"<path") == 2
    assert "1 shading" in " ".join(notes)


def test_shading_of_a_shape_needs_a_ground_and_curves(drawing):
    shape = next(shape for shape in drawing.shapes if shape.shading is not None)
    assert isinstance(shape.shading, Scene)
    text = write_drawing(drawing, title="", comment="")
    with pytest.raises(InputError, match="without a ground"):
        read_drawing(re.sub(r'(<g opacity="[^>]*>)(\s*<rect[^>]*/>)+', r"\1", text))


def test_numbers_are_as_fine_as_small_curves_need(drawing):
    small = scaled_drawing(drawing, SIDE // 6, SIDE // 6)
    scales = [re.findall(r"scale\(([^)]*)\)", write_drawing(d, title="", comment="")) for d in (drawing, small)]
    assert float(scales[1][0]) < float(scales[0][0]) <= 0.5


def test_an_interrupt_leaves_the_objects_in_their_paints(monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.photo.loop.FitLoop.relax", ctrl_c)
    with under_way(Work()) as work:
        made = shade_objects(shaded_objects(ball()), QUICK)
    assert work.interrupted
    assert len(made.shapes) == 2
    assert all(shape.shading is None for shape in made.shapes)


def sign(shape: tuple[int, int] = (84, 120)) -> np.ndarray:
    """(H, W, 4) levels of rings and a thin bar on shading that is no gradient."""
    y, x = np.mgrid[: shape[0], : shape[1]] + 0.5
    lights = [np.exp(-((x - cx) ** 2 + (y - cy) ** 2) / 1800.0) for cx, cy in ((20, 15), (105, 30), (55, 80))]
    levels = np.stack([110 + 120 * lights[0], 70 + 130 * lights[1], 150 + 100 * lights[2]], axis=2)
    for middle in (24.0, 48.0, 72.0, 96.0):
        ring = np.clip(2.0 - np.abs(np.hypot(x - middle, y - 34.0) - 9.5), 0.0, 1.0)[..., None]
        levels = levels + ring * (255.0 - levels)
    levels[60:63, 20:100] = 255.0
    return np.dstack([np.rint(levels), np.full(shape, 255.0)]).astype(np.float32)


def test_a_surface_is_what_no_gradient_explains_and_goes_on_in_the_holes_of_letters():
    levels = sign()
    (surface,) = surfaces_of(levels, Condition())
    white = (levels == 255.0).all(axis=2)
    assert not (surface.mask & white).any()
    assert surface.mask[33:35, [24, 48, 72, 96]].all()
    assert np.abs(surface.colours[surface.mask] - levels[surface.mask]).max() <= 8.0
    across = np.linspace(0.0, 255.0, 120)[None, :, None] * np.ones((84, 1, 3))
    assert surfaces_of(np.dstack([across, np.full((84, 120), 255.0)]).astype(np.float32), Condition()) == []


@pytest.mark.parametrize(("quality", "most"), [(None, 3.0), (92, 6.0)])
def test_what_lies_on_a_surface_is_drawn_as_without_shading(quality, most):
    plain = sign()
    levels = plain
    if quality is not None:
        file = recoded(plain[..., :3].astype(np.uint8), quality=quality)
        levels = with_channels(file.astype(np.float32), 4, 255.0)
    condition = prepare(levels / np.float32(255.0)).condition
    drawing = shade_surfaces((levels, objects_of(levels)), condition, QUICK)
    assert drawing is not None and any(shape.shading for shape in drawing.shapes)
    off = levels_off(plain / 255.0, write_drawing(drawing, title="", comment=""))
    assert off[22:66, 12:108].mean() < most
    assert sum(min(shape.fill) >= 240 for shape in drawing.shapes) >= 2


def test_objects_that_hold_all_there_is_are_shaded_as_objects():
    objects = shaded_objects(ball())
    assert objects is not None and surfaces_of(objects[0], Condition())
    assert shade_surfaces(objects, Condition(), QUICK) is None
