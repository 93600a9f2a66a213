"""The pages of `--report`: what is in them, that they stay small, and that no foreign file can act in them."""

from __future__ import annotations

import base64
import io
import json
import re
import shlex
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_runs import asked_by
from conftest import rest_slow, smooth_pixels
from image_files import encode
from PIL import Image, ImageDraw

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.files.load import load_picture
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.formatting import duration
from cubicsplat_cli.html_report.embed import picture_url, shown_elements
from cubicsplat_cli.html_report.index import Entry, index
from cubicsplat_cli.html_report.page import Subject, command, course, histogram, page, ticks
from cubicsplat_cli.metrics import Quality, Report
from cubicsplat_cli.options import Focus
from cubicsplat_cli.pipeline.vectorize import vectorize_picture
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings
from cubicsplat_cli.svg.scene_reader import read_svg

ROOT = Path(__file__).resolve().parents[1]
SHORT = {"curves": 9, "steps": 60, "threads": 1}
FRAME = 34_000  # bytes of a page beside what it shows


def page_about(svg: bytes, data: bytes, report: Report | None = None, **more) -> str:
    quality = Quality(30.0, 0.9, False)
    given = load_picture(data), data, "a.svg", svg, quality, "r 1", report, sha256_of(svg), len(svg)
    return page(Subject(*given, **more), threads=1).decode()


def data_of(text: str) -> dict:
    return json.loads(re.search(r'id="cs-data">(.*?)</script>', text, re.DOTALL)[1])


@pytest.fixture(scope="module")
def sample() -> tuple[bytes, str, Report]:
    """A PNG, its SVG and the report, of a short fit."""
    data = encode(Image.fromarray(smooth_pixels(48, 36)))
    result = vectorize(data, style="photo", **SHORT)
    return data, result.svg, result.report


def test_a_page_has_the_curves_their_worth_the_course_and_the_command(sample):
    data, svg, report = sample
    text = page_about(svg.encode(), data, report)
    assert svg.count("<path") == text.split('<g class="drawing">')[1].split("</g></svg>")[0].count("<path")
    found = data_of(text)
    assert (found["kind"], len(found["losses"])) == ("curve", svg.count("<path"))
    for words in ("Closeness", "Inequality", "Curves replaced", "Worth of the curves", "Where the time went"):
        assert words in text
    assert "cubicsplat vectorize" in text
    assert text.count("<script") == 2


def test_a_curve_is_worth_what_the_picture_loses_without_it(sample):
    from cubicsplat_cli import read_svg, render_scene
    from cubicsplat_cli.scene import Scene

    data, svg, _ = sample
    picture, scene = load_picture(data), read_svg(svg)

    def level(of: Scene) -> float:
        return -10.0 * np.log10(((render_scene(of, samples=48) - picture.target()) ** 2).mean())

    losses = shown_elements(svg.encode(), picture).losses_db[::-1]  # front to back, as the scene has them
    for curve in range(scene.curves):
        keep = [index for index in range(scene.curves) if index != curve]
        fields = {name: getattr(scene, name)[keep] for name in ("points", "colours", "opacities", "half_widths")}
        assert losses[curve] == pytest.approx(level(scene) - level(replace(scene, **fields)), abs=2e-3)


def test_shapes_of_artwork_in_one_path_have_one_worth():
    pixels = np.full((24, 64, 3), 255, np.uint8)
    for left in (4, 24, 44):  # paths, not primitives
        pixels[4:20, left : left + 5] = pixels[15:20, left : left + 12] = (20, 60, 120)
    result = vectorize(pixels, style="artwork", threads=1)
    elements = len(re.findall(r"<(?:path|rect|circle|ellipse)\b", result.svg))
    found = shown_elements(result.svg.encode(), load_picture(encode(Image.fromarray(pixels))))
    assert len(found.losses_db) == elements < result.report.shapes
    assert min(found.losses_db) > 10


def drawn(kind: str) -> Image.Image:
    random = np.random.default_rng(1)
    if kind == "cells":
        fills = np.array([[0, 0, 0], [255, 255, 255], [200, 30, 30]], np.uint8)
        return Image.fromarray(random.choice(fills, (8, 8)).repeat(6, 0).repeat(6, 1))
    if kind == "photo":
        return Image.fromarray(random.integers(0, 256, (4, 5, 3), dtype=np.uint8).repeat(5, 0).repeat(5, 1))
    picture = Image.new("RGB", (240, 120), "white")
    if kind == "gradient":
        picture = Image.fromarray(np.linspace((30, 0, 90), (230, 0, 90), 240).astype(np.uint8)[None].repeat(120, 0))
    for left in (20, 100, 180):
        corners = (left, 20), (left + 40, 30), (left + 20, 90)
        if kind == "strokes":
            ImageDraw.Draw(picture).line(corners, (20, 60, 120), 8)
        else:
            ImageDraw.Draw(picture).polygon(corners, (250, 250, 250) if kind == "gradient" else (20, 60, 120))
    return picture.resize((120, 60), Image.Resampling.LANCZOS)


@pytest.mark.parametrize("kind", ["cells", "letters", "gradient", "strokes", "photo"])
def test_summary_report_page_and_file_count_alike(kind, tmp_path, run_cli):
    drawn(kind).save(tmp_path / "x.png")
    few = ("--style", "photo", "--curves", 5, "--steps", 20) if kind == "photo" else ("--style", "artwork")
    mode = ("--mode", "open") if kind == "strokes" else ()
    done = run_cli("vectorize", tmp_path / "x.png", *few, *mode, "--threads", 1, "--report")
    svg = (tmp_path / "x.svg").read_text()
    report = Report.from_json((tmp_path / "x.json").read_bytes())
    assert f"<dt>time</dt><dd>{duration(report.timing.total_s)}</dd>" in (tmp_path / "x.html").read_text()
    elements = len(re.findall(r"<(?:path|circle|ellipse|rect)\b", svg)) - (kind == "photo")  # the photo's background
    shapes = elements if kind == "cells" else read_svg(svg).curves  # all cells of one colour are one shape
    assert report.output.paths == elements
    said = f"{shapes} curves" if kind == "photo" else f"{shapes} shapes"
    if kind == "photo":
        assert (report.shapes, report.count()) == (None, shapes)
    elif kind == "cells":
        assert report.shapes == report.count() == shapes
    else:
        assert report.shapes == report.count() == shapes > elements, "shapes of one paint are in one element"
        said += f" in {elements} element{'s' * (elements > 1)}"
    assert f"  {said}  " in done.stderr.decode()
    facts = re.sub(r"<[^>]*>|\s+", " ", (tmp_path / "x.html").read_text())
    number, name, *more = said.split(maxsplit=2)
    assert re.search(rf"\b{name}\b\s+{number}\b\s+{' '.join(more)}", facts), said


HOSTILE = (
    "<!--> <script>alert(1)</script> -->",
    "<title><![CDATA[</title><script>alert(1)</script>]]></title>",
    "<?x <script>alert(1)</script> ?>",
)


@pytest.mark.parametrize("hostile", HOSTILE)
def test_what_html_would_read_otherwise_than_xml_is_left_out(sample, hostile):
    data, svg, _ = sample
    changed = (
        svg.replace("<g id", f"{hostile}<g id")
        if "title" not in hostile
        else svg.replace("<title>", hostile + "<title>")
    )
    text = page_about(changed.encode(), data)
    assert "alert" not in text.split('class="drawing"')[1].split('class="cam picture"')[0].replace("data:", "")
    assert text.count("<script") == 2


def test_a_foreign_svg_is_shown_as_a_picture(sample):
    foreign = b'<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9" onload="alert(1)"><g/></svg>'
    text = page_about(foreign, sample[0])
    assert "onload" not in text
    assert base64.b64encode(foreign).decode() in text
    assert data_of(text) == {"height": 36, "kind": "", "losses": [], "width": 48}
    assert "Outlines" not in text


def test_names_are_text(sample):
    data, svg, report = sample
    subject = Subject(
        load_picture(data), data, "<b>a&b</b>.svg", svg.encode(), None, None, report, "0", 9, notes=("<i>x</i>",)
    )
    text = page(subject, threads=1).decode()
    assert "&lt;b&gt;a&amp;b&lt;/b&gt;.svg" in text
    assert "<b>a" not in text
    assert "<i>x" not in text


@pytest.mark.parametrize("name", rest_slow("astronaut.jpg", "chelsea.png"))
def test_a_page_is_at_most_three_times_what_it_shows(name):
    data = (ROOT / "samples" / name).read_bytes()
    result = vectorize(data, style="photo", curves=256, steps=4, measure=False)
    svg = result.svg.encode()
    text = page_about(svg, data, result.report).encode()
    assert len(text) <= 3 * (len(svg) + len(data))
    assert len(text) <= 1.4 * (len(svg) + len(data)) + FRAME


RGB = smooth_pixels(40, 28)
RGBA = smooth_pixels(40, 28, alpha=True)
TURNED = Image.Exif()
TURNED[0x0112] = 6


@pytest.mark.parametrize(
    ("data", "mime", "kept"),
    [
        (encode(Image.fromarray(RGB)), "png", True),
        (encode(Image.fromarray(RGBA)), "png", True),
        (encode(Image.fromarray(RGB), "JPEG"), "jpeg", True),
        (encode(Image.fromarray(RGB), "WEBP", lossless=True), "webp", True),
        (encode(Image.fromarray(RGB), "JPEG", exif=TURNED), "webp", False),
        (encode(Image.fromarray(RGB), "BMP"), "webp", False),
        (encode(Image.fromarray(RGBA), "TIFF"), "webp", False),
    ],
)
def test_the_original_is_the_file_where_browsers_show_the_same(data, mime, kept):
    picture = load_picture(data)
    head, body = picture_url(picture, data).split(",")
    found = base64.b64decode(body)
    assert head == f"data:image/{mime};base64"
    assert (found == data) == kept
    with Image.open(io.BytesIO(found)) as image:
        assert image.size == (picture.width, picture.height)
        values = np.asarray(image.convert("RGB")) / 255.0
    seen = 1.0 if picture.alpha is None else (picture.alpha > 0)[..., None]
    assert np.abs(values - picture.rgb)[np.broadcast_to(seen, values.shape) > 0].mean() < 0.02


REQUESTS = [
    Request(),
    Request(FitSettings.from_preset("high", "open", curves=33, seed=4, background="teal", opaque=True), style="photo"),
    Request(FitSettings.from_preset("draft", time_limit=2.5, prune=False, crossing_penalty=0.25, samples=40)),
    Request(artwork=ArtworkSettings(colors=3, palette=((1, 2, 3), (255, 0, 9)), detail=2.5), style="artwork"),
    Request(precision=4, max_size=300, frame=1),
    Request(FitSettings.from_preset("paper", rate_colours=0.2, prune_rule="decay", finish_samples=60), style="photo"),
    Request(artwork=ArtworkSettings(strokes=True, completion="off", min_area=2.5)),
    Request(focus=Focus(1, 2, 5.5, 4, 3)),
]


@pytest.mark.parametrize("request_", REQUESTS)
def test_the_command_asks_for_the_same_again(request_, monkeypatch):
    picture = load_picture(encode(Image.fromarray(smooth_pixels(8, 8))))
    quick = replace(request_, settings=request_.settings.with_(steps=1), measure=False)
    report = vectorize_picture(picture, quick).report
    report = replace(report, settings=request_.deciding(), input=replace(report.input, path="a 'b.png"))
    words = shlex.split(command(report))
    assert words[:3] == ["cubicsplat", "vectorize", "a 'b.png"]
    assert asked_by(monkeypatch, *words[1:]).digest() == request_.digest()


def test_ticks_are_round_and_within():
    assert ticks(0.0, 10.0, 4) == [0.0, 2.5, 5.0, 7.5, 10.0]
    assert ticks(23.1, 31.9, 3) == [25.0, 30.0]
    assert ticks(5.0, 5.0, 3) == [5.0]


def test_a_course_rises_where_its_values_do():
    chart = course("t", "a", [0.0, 1.0, 2.0], [20.0, 30.0, 25.0], 1)
    heights = [float(point.split()[1]) for point in chart.line[1:].split("L")]
    assert heights[1] < heights[2] < heights[0]
    assert chart.last == "25.0"


def test_a_histogram_counts_all_values():
    values = [-0.2, 0.0, 1e-7, 0.01, 0.011, 2.0]
    chart = histogram("t", "a", values)
    assert sum(int(text.split(":")[0]) for *_, text in chart.bars) == len(values)


def test_the_index_links_what_is_there_and_says_what_is_not(tmp_path):
    entries = [
        Entry("a.png", tmp_path / "sub" / "a #1.html", None, "photo", Quality(31.0, 0.9, False), 2_000, 12, 3.0),
        Entry("b.png", tmp_path / "b.html", None, "artwork", Quality(None, 1.0, True), 100, 3, 1.0),
        Entry("c.png", error="c.png: is damaged"),
    ]
    text = index(tmp_path / "index.html", entries, "t").decode()
    assert 'href="./sub/a%20%231.html"' in text
    assert 'data-value="inf"' in text
    assert "<p>is damaged</p>" in text
    assert "31.00 dB" in text  # the mean of those that have one


def test_vectorize_writes_a_page_and_later_makes_a_missing_one(run_cli, photo):
    arguments = ("vectorize", photo, "--style", "photo", "--curves", 9, "--steps", 20, "--threads", 1)
    run_cli(*arguments)
    svg, made = photo.with_suffix(".svg"), photo.with_suffix(".html")
    before = svg.stat().st_mtime_ns
    assert not made.exists()
    done = run_cli(*arguments, "--report")
    assert (b"unchanged" in done.stderr, b"to look at: " in done.stderr) == (True, True)
    assert svg.stat().st_mtime_ns == before
    first = made.read_bytes()
    run_cli(*arguments, "--report")
    assert made.read_bytes() == first
    run_cli(*arguments, "--report", "--seed", 3)
    assert sha256_of(svg.read_bytes()).encode() in made.read_bytes()[:200]


def test_a_folder_has_an_index_in_the_order_of_its_names(run_cli, tmp_path):
    fit = ("-o", f"{tmp_path}/out/", "--report", "--style", "photo", "--curves", 5, "--steps", 9, "--threads", 1)
    for name in ("b.png", "a.png"):
        (tmp_path / name).write_bytes(encode(Image.fromarray(smooth_pixels(24, 20))))
        run_cli("vectorize", tmp_path / name, *fit)
    run_cli("vectorize", tmp_path, *fit)
    assert str(tmp_path) not in (tmp_path / "out" / "index.html").read_text(), "where they lie is nobody's business"
    assert re.findall(r'href="\./(\w+).html">[^<]', (tmp_path / "out" / "index.html").read_text()) == ["a", "b"]
    (tmp_path / "index.png").write_bytes((tmp_path / "a.png").read_bytes())
    run_cli("vectorize", tmp_path / "index.png", *fit, "--force")  # over the index, which is ours
    run_cli("vectorize", tmp_path, tmp_path / "none*.png", *fit, code=1)
    text = (tmp_path / "out" / "index-2.html").read_text()
    assert re.findall(r'href="\./(\w+).html">[^<]', text) == ["a", "b", "index"]
    assert text.count("<p>") == 1


def test_a_file_of_somebody_else_is_kept(run_cli, photo):
    page_path = photo.with_suffix(".html")
    page_path.write_text("<p>mine</p>")
    run_cli("vectorize", photo, "--report", code=2, error="was not written by cubicsplat")
    run_cli("vectorize", photo, "-o", "-", "--report", code=2)
    run_cli("eval", photo, photo, "--report", page_path, code=2)
    run_cli("eval", photo, photo, "--report", photo.with_suffix(".pdf"), code=2)
    assert page_path.read_text() == "<p>mine</p>"


def test_eval_shows_a_pair_with_what_is_known_of_the_run(run_cli, photo, tmp_path):
    run_cli(
        "vectorize", photo, "-o", tmp_path / "a.svg", "--style", "photo", "--curves", 9, "--steps", 60, "--threads", 1
    )
    run_cli("eval", photo, tmp_path / "a.svg", "--report", tmp_path / "e.html")
    assert "Make it again" in (tmp_path / "e.html").read_text()
    (tmp_path / "a.json").unlink()
    run_cli("eval", photo, tmp_path / "a.svg", "--report", tmp_path / "e.html")
    text = (tmp_path / "e.html").read_text()
    assert ("Make it again" in text, "Worth of the curves" in text) == (False, True)
    run_cli("eval", photo, tmp_path / "a.png", "--report", tmp_path / "p.html")
    assert "candidate" in (tmp_path / "p.html").read_text()


def test_eval_of_two_folders_writes_an_index(run_cli, tmp_path):
    for folder in ("one", "two"):
        (tmp_path / folder).mkdir()
        (tmp_path / folder / "a.png").write_bytes(encode(Image.fromarray(smooth_pixels(24, 20))))
    run_cli("eval", tmp_path / "one", tmp_path / "two", "--report", tmp_path / "pages")
    assert "identical" in (tmp_path / "pages" / "index.html").read_text()
    assert (tmp_path / "pages" / "a.png.html").is_file()
