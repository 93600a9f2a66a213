"""`--max-bytes 400gz`: polygons on a coarse grid, in files of a few hundred bytes."""

from __future__ import annotations

import gzip
import re
from contextlib import closing
from threading import Event
from urllib.parse import unquote

import numpy as np
import pytest
from cli_runs import strict_json
from conftest import ctrl_c

from cubicsplat_cli import vectorize
from cubicsplat_cli.cli.run import summary_line
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.options import GzipBytes, parse_bytes
from cubicsplat_cli.pipeline.tiny import TinySearch
from cubicsplat_cli.pipeline.vectorize import dominant_colors
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.polygons import GridPolygons, grid_size, polygons_on_grid

SHORT = {"steps": 80, "threads": 1, "style": "photo"}
OPTIONS = ("--steps", 60, "--threads", 1, "--style", "photo", "--json", "-q")


@pytest.fixture(scope="module")
def hills() -> np.ndarray:
    """Three slopes before a sky, (64, 96, 3) uint8."""
    y, x = np.mgrid[:64, :96]
    picture = np.stack([200 - y, 210 - y / 2, 230 + 0 * y], axis=-1)
    for height, lean, colour in ((30, 0.2, (60, 110, 90)), (58, -0.4, (150, 120, 60)), (24, 0.5, (50, 60, 40))):
        picture = np.where((y > height + lean * x)[..., None], np.array(colour) + (x % 24)[..., None], picture)
    return np.clip(picture, 0, 255).astype(np.uint8)


@pytest.fixture(scope="module")
def placeholder(hills):
    return vectorize(hills, max_bytes="300gz", **SHORT)


@pytest.fixture
def hills_file(hills, tmp_path):
    from PIL import Image

    path = tmp_path / "hills.png"
    Image.fromarray(hills).save(path)
    return path


def packed_size(svg: str) -> int:
    return len(gzip.compress(svg.encode(), 9, mtime=0))


def test_amounts_after_gzip():
    assert [(parse_bytes(t), isinstance(parse_bytes(t), GzipBytes)) for t in ("400gz", "1.5kGZ", "400")] == [
        (400, True), (1500, True), (400, False),
    ]  # fmt: skip
    assert parse_bytes(parse_bytes("400gz")) == 400
    for wrong in ("gz", "0gz", "4 hundredgz", "400gzz"):
        with pytest.raises(UsageError, match="400gz"):
            parse_bytes(wrong)
    assert request_of({"max_bytes": "400gz"}).deciding()["max_bytes"] == "400gz"
    assert request_of({"max_bytes": "400gz"}).digest() != request_of({"max_bytes": "400"}).digest()


def test_a_tiny_file_holds_polygons_and_nothing_else(placeholder):
    svg = placeholder.svg
    assert 285 <= packed_size(svg) <= 300
    assert re.fullmatch(
        r'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 \d\d \d\d" fill-opacity="\.\d">'
        r'<path d="m0 0h\d\dv\d\dH0" fill="#[0-9a-f]{3}" fill-opacity="1"/>'
        r'(<path d="m[-0-9 ]+" fill="#[0-9a-f]{3}"/>)+</svg>',
        svg,
    )
    report = placeholder.report
    assert (report.style, report.settings["max_bytes"], report.settings["shapes"]) == ("photo", "300gz", "polygon")
    assert report.output.compressed_bytes == packed_size(svg)
    assert f", {packed_size(svg)} B gzipped" in summary_line(report)
    assert report.output.paths == svg.count("<path") - 1 == placeholder.scene.curves
    assert report.quality.svg.psnr_db > 24.0
    assert report.quality.agreement_db > 48.0


@pytest.mark.slow
def test_more_bytes_are_nearer(hills, placeholder):
    more = vectorize(hills, max_bytes="600gz", **SHORT)
    assert more.report.quality.svg.psnr_db > placeholder.report.quality.svg.psnr_db + 0.7


def random_polygons(size: tuple[float, float], n: int = 8) -> GridPolygons:
    generator = np.random.default_rng(3)
    vertices = [generator.integers(0, (int(size[0]), int(size[1])), (4, 2)) for _ in range(n)]
    return GridPolygons(size, vertices, generator.integers(0, 16, (n, 3)), np.array([7, 8, 9]), 7)


def test_the_search_gets_back_what_rounding_costs(hills):
    """Its loss and bytes, of which it only looks at parts, are those of the whole at its end."""
    polygons = random_polygons((48.0, 32.0))
    with closing(CpuEngine(1)) as engine:
        search = TinySearch(polygons, as_picture(hills), None, engine, FitSettings(threads=1))
        before = search.loss
        search.run(10_000, np.inf, Event())
        assert search.loss < 0.3 * before
    drawn = render_scene(search.polygons.scene(96, 64), samples=1)
    assert search.loss == pytest.approx(float(np.square(drawn - hills / np.float32(255)).sum()), rel=1e-4)
    assert search.bytes == packed_size(search.polygons.text())


def test_an_interrupted_search_still_fits(hills):
    with closing(CpuEngine(1)) as engine:
        search = TinySearch(random_polygons((48.0, 32.0), 20), as_picture(hills), None, engine, FitSettings(threads=1))
        search._sweep = ctrl_c
        assert search.run(250, np.inf, Event())
        assert packed_size(search.polygons.text()) <= 250 < packed_size(random_polygons((48.0, 32.0), 20).text())


def test_the_file_does_not_depend_on_the_threads(hills, placeholder):
    """Several fits are made at once, on as many threads as there are."""
    assert vectorize(hills, max_bytes="300gz", **SHORT | {"threads": 3}).svg == placeholder.svg


def test_an_interrupt_ends_all_fits(hills):
    drawn = vectorize(hills, max_bytes="300gz", on_progress=ctrl_c, **SHORT | {"steps": 100_000, "threads": 3})
    assert drawn.report.interrupted and packed_size(drawn.svg) <= 300


def test_triangles_stay_triangles(hills):
    drawn = vectorize(hills, max_bytes="300gz", shapes="triangle", **SHORT)
    numbers = [len(re.findall(r"-?\d+", d)) for d in re.findall(r'd="m([-0-9 ]+)"', drawn.svg)]
    assert numbers == [6] * len(numbers)


def test_pixels_without_weight_do_not_count(hills):
    weights = np.zeros((64, 96), np.uint8)
    weights[:, :32] = 255
    left = vectorize(hills, max_bytes="260gz", weights=weights, **SHORT).report.quality
    assert left.weighted_psnr_db > left.svg.psnr_db + 3.0


@pytest.mark.slow
def test_a_transparent_picture_has_no_background(hills):
    alpha = np.where(np.arange(96) < 48, 255, 0) * np.ones((64, 1))
    drawn = vectorize(np.dstack([hills, alpha.astype(np.uint8)]), max_bytes="300gz", **SHORT)
    assert "h4" not in drawn.svg and packed_size(drawn.svg) <= 300
    assert drawn.pixels[:, 60:, 3].mean() < 40 < 150 < drawn.pixels[:, :40, 3].mean()


@pytest.mark.parametrize(
    ("size", "units"), [((300, 200), (63, 42)), ((1080, 1920), (36, 64)), ((500, 333), (60, 39.96))]
)
def test_the_grid_keeps_the_shape_of_the_picture(size, units):
    assert grid_size(*size, 62) == units
    assert units[0] / units[1] == pytest.approx(size[0] / size[1], rel=5e-4)


def test_rounding_to_the_grid_keeps_a_drawing_that_is_on_it():
    polygons = random_polygons((60.0, 40.0))
    again = polygons_on_grid(polygons.scene(300, 200), polygons.size)
    assert again.text() == polygons.text()


def test_a_polygon_begins_where_its_path_compresses_best(hills):
    polygons = random_polygons((48.0, 32.0))
    with closing(CpuEngine(1)) as engine:
        search = TinySearch(polygons, as_picture(hills), None, engine, FitSettings(threads=1))
        before, drawn = search.bytes, polygons.scene(96, 64)
        for index in range(8):
            search._turn(index)
    assert search.bytes == packed_size(polygons.text()) < before
    again = render_scene(polygons.scene(96, 64), samples=1)
    assert np.allclose(again, render_scene(drawn, samples=1), atol=1e-5)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("threads", [1, 3])
def test_steps_change_the_loss_as_they_say(hills, alpha, threads):
    """Nearly: they measure coverage along two lines in a row of pixels."""
    picture = np.dstack([hills, np.full((64, 96, 1), 180, np.uint8)]) if alpha else hills
    polygons = random_polygons((48.0, 32.0))
    if alpha:
        polygons.background = None
    weights = np.linspace(0.5, 1.5, 64 * 96, dtype=np.float32).reshape(64, 96)
    with closing(CpuEngine(1)) as engine:
        settings = FitSettings(threads=threads)
        search = TinySearch(polygons, as_picture(picture), weights, engine, settings)
        search._update_steps()
        before, own = search.loss, (polygons.vertices[3], polygons.colours[3].copy())
        found = list(search.steps.best(3, 0.01))
        for _, rise, vertices, colour in found:
            polygons.vertices[3], polygons.colours[3] = vertices, colour
            assert rise < 0.0 and search._loss() - before == pytest.approx(rise, rel=0.01)
        polygons.vertices[3], polygons.colours[3] = own
        rises = search.steps.removals(3, 4)
        for vertex, rise in enumerate(rises[:-1]):
            polygons.vertices[3] = np.delete(own[0], vertex, axis=0)
            assert search._loss() - before == pytest.approx(rise, rel=0.01)
        polygons.vertices[3] = own[0][[0, 0, 0]]
        assert search._loss() - before == pytest.approx(rises[-1], rel=0.01)
    assert len(found) == 5


def test_the_bytes_that_are_allowed_are_used():
    """A byte becomes cheaper until they are, also where it gives little, as it does in noise."""
    noise = np.random.default_rng(1).integers(0, 256, (64, 96, 3)).astype(np.uint8)
    with closing(CpuEngine(1)) as engine:
        search = TinySearch(random_polygons((48.0, 32.0), 12), as_picture(noise), None, engine, FitSettings(threads=1))
        search.run(280, np.inf, Event())
    assert 276 < search.bytes <= 280


def test_more_than_4_kb_is_a_usual_file_whose_compressed_bytes_count(hills):
    drawn = vectorize(hills, max_bytes="5kgz", **SHORT)
    assert 4500 <= packed_size(drawn.svg) <= 5000
    assert "<title>" in drawn.svg


def test_too_few_bytes_are_one_line(hills_file, run_cli):
    done = run_cli("vectorize", hills_file, *OPTIONS, "--max-bytes", "100gz", code=1)
    assert done.stderr.count(b"\n") == 1
    assert b"not even one polygon fits into 100 bytes; allow at least" in done.stderr
    least = int(done.stderr.split(b"at least")[1])
    run_cli("vectorize", hills_file, *OPTIONS, "--max-bytes", f"{least + 20}gz")


@pytest.mark.parametrize(
    "options", [{"mode": "open"}, {"fill": "linear"}, {"precision": 1}, {"shapes": "ellipse"}, {"loss": "l1"}]
)
def test_what_polygons_on_a_grid_cannot_be_is_refused(options):
    with pytest.raises(UsageError, match=f"{next(iter(options))} does not go with --max-bytes below 4kgz"):
        request_of({"max_bytes": "400gz", **options})
    request_of({"max_bytes": "40kgz", **options})


def test_its_json_knows_a_file_without_a_comment(hills_file, run_cli):
    """It is left alone, replaced and, once edited, kept like any other."""
    svg = hills_file.with_suffix(".svg")
    command = ("vectorize", hills_file, *OPTIONS, "--no-png", "--max-bytes")
    run_cli(*command, "200gz")
    made = svg.read_bytes()
    assert b"<!--" not in made
    assert strict_json(run_cli(*command, "200gz").stdout)["status"] == "unchanged"
    assert strict_json(run_cli(*command, "170gz").stdout)["status"] == "done"
    assert len(svg.read_bytes()) < len(made)
    svg.write_bytes(svg.read_bytes() + b" ")
    run_cli(*command, "200gz", code=2, error="--force")
    svg.write_bytes(made)
    svg.with_suffix(".json").unlink()
    run_cli(*command, "200gz", code=2, error="or is a placeholder whose JSON is gone; use --force")


def test_a_data_uri_holds_the_same_drawing(placeholder):
    uri = placeholder.data_uri()
    assert uri.startswith("data:image/svg+xml,%3Csvg xmlns='http://www.w3.org/2000/svg'")
    assert not set('"#<>\n') & set(uri)
    assert len(uri) < 1.2 * len(placeholder.svg)
    text = unquote(uri.partition(",")[2])
    assert text.replace("'", '"') == placeholder.svg == placeholder._repr_svg_()


def test_a_title_comes_through_a_data_uri():
    from cubicsplat_cli.svg.markup import data_uri

    svg = '<?xml version="1.0"?>\n<svg a="1">\n<title>50 % "Käse" & \'more\'</title>\n<p b="it\'s"/></svg>\n'
    text = unquote(data_uri(svg).partition(",")[2])
    assert text == "<svg a='1'><title>50 % \"Käse\" & 'more'</title><p b=\"it's\"/></svg>"


def test_data_uris_go_to_standard_output(hills_file, run_cli):
    command = ("vectorize", hills_file, "--steps", 20, "--threads", 1, "--max-bytes", "200gz", "--data-uri", "-q")
    command = (*command, "--style", "photo")
    printed = run_cli(*command, "-o", "-").stdout
    assert printed.startswith(b"data:image/svg+xml,%3Csvg") and printed.count(b"\n") == 1
    assert run_cli(*command).stdout == printed == run_cli(*command).stdout, "made, and found unchanged"
    svg = hills_file.with_suffix(".svg").read_text()
    assert unquote(printed.decode().strip().partition(",")[2]).replace("'", '"') == svg
    for wrong in ("--json", "--svgz"):
        run_cli(*command, wrong, code=2)


def test_the_json_names_the_dominant_colours(hills, placeholder):
    colors = placeholder.report.colors
    assert 3 <= len(colors) <= 5
    assert [c["share"] for c in colors] == sorted((c["share"] for c in colors), reverse=True)
    assert sum(c["share"] for c in colors) == pytest.approx(1.0, abs=0.01)
    pixels = hills.reshape(-1, 3).astype(float)
    for color in colors:
        assert np.abs(pixels - list(bytes.fromhex(color["hex"][1:]))).max(1).min() < 16
    flat = np.full((8, 8, 3), (255, 0, 17), np.uint8)
    assert dominant_colors(as_picture(flat)) == [{"hex": "#ff0011", "share": 1.0}]
    assert dominant_colors(as_picture(np.zeros((4, 4, 4), np.uint8))) == []
