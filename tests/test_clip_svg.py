"""An animated SVG plays what was fitted: read back, in Chromium inline and as an image, and as Lottie."""

from __future__ import annotations

import io
import json
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from clip_reader import read_clip
from conftest import rest_slow, smooth_pixels
from moving_scenes import RIGID, STILL, moving_scene, scene_at, two_groups
from PIL import Image

import cubicsplat_cli
from cubicsplat_cli.clip_request import ClipRequest
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.export.lottie import lottie
from cubicsplat_cli.files.clips import clip_of_pictures
from cubicsplat_cli.files.marks import svg_is_ours
from cubicsplat_cli.html_report.animation import player_page
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.moving import OFFSET, SHAPE, shown_at, to_grid_clip
from cubicsplat_cli.svg.moving_file import write_clip
from cubicsplat_cli.svg.scene_writer import path_values

ALIKE_DB = 30.0  # Chromium's antialiasing against ours, where strokes are half of all pixels
ANIMATION = re.compile(r"<animate.*?/>")


def written(clip=None, precision: int = 1, **options) -> str:
    return write_clip(to_grid_clip(clip or two_groups(), precision), **options)


@pytest.mark.parametrize("mode", Mode)
def test_a_file_that_is_read_back_plays_every_frame_as_it_was_fitted(mode):
    clip = two_groups(mode)
    back = read_clip(written(clip))
    for group, moving in zip(back.groups, clip, strict=True):
        for frame, scene in enumerate(back.scenes(group, shown_at(moving))):
            wanted = scene_at(moving, frame)
            # Half a step of the grid, half of one by a knot that was left out, and what the time of a knot is off.
            np.testing.assert_allclose(scene.points, wanted.points, atol=0.05 + 0.05 + 0.5)
            np.testing.assert_allclose(scene.colours, wanted.colours, atol=0.03)
            np.testing.assert_allclose(scene.opacities, wanted.opacities, atol=0.03)
            np.testing.assert_allclose(scene.half_widths, wanted.half_widths, atol=0.06)
            assert scene.background == pytest.approx(wanted.background, abs=0.5 / 255)


def test_the_numbers_before_writing_are_those_of_the_file():
    grid = to_grid_clip(two_groups(), 2)
    back = read_clip(write_clip(grid))
    for mine, read in zip(grid.groups, back.groups, strict=True):
        times = np.linspace(mine.begin, mine.end, 9)[:-1]
        for first, second in zip(grid.scenes(mine, times), back.scenes(read, times), strict=True):
            # The times of knots are right within a thirtieth of a frame; points move up to 15 px in one here.
            np.testing.assert_allclose(first.points, second.points, atol=0.5)
            np.testing.assert_allclose(first.colours, second.colours, atol=0.03)


def test_nothing_is_written_of_what_does_not_move():
    grid = to_grid_clip([moving_scene(0)], 1)
    root = ElementTree.fromstring(write_clip(grid).encode())
    paths = root.findall(".//{*}path")[::-1]
    assert all(len(path) == 0 for path in paths[:STILL])
    for path in paths[STILL:RIGID]:
        assert [(each.tag.rpartition("}")[2], each.get("type")) for each in path] == [("animateTransform", "translate")]
    assert all(len(tracks[SHAPE].keys) == 1 for tracks in grid.groups[0].curves[:RIGID])
    assert all(len(tracks[OFFSET].keys) > 1 for tracks in grid.groups[0].curves[STILL:RIGID])


def test_offsets_of_the_fit_become_translations():
    group = moving_scene(0)
    group.by_name["shapes"].still[-1] = True
    group.by_name["offsets"].values[:, -1] = 4.0 + np.arange(group.frames)[:, None]
    start = scene_at(group, 0).points[-1]
    tracks = to_grid_clip([group], 1).groups[0].curves[-1]
    assert len(tracks[SHAPE].keys) == 1 and tracks[OFFSET].values.tolist() == [[0, 0], [60, 60]]
    np.testing.assert_allclose(tracks[SHAPE].values[0] / 10.0, start.ravel(), atol=0.05)


def test_all_values_of_a_path_have_one_structure():
    for text in re.findall(r'attributeName="d" values="([^"]*)"', written()):
        letters = {re.sub(r"[^A-Za-z]", "", value) for value in text.split(";")}
        assert len(letters) == 1
    # Relative where that is shorter for all of them.
    points = [[1000, 1000], [1001, 1002], [1003, 1004], [1005, 1006], [1000, 1001], [1001, 1000]]
    assert path_values([points], closed=True) == ["M1000 1000c1 2 3 4 5 6-5-5-4-6-5-6z"]


def test_the_still_picture_is_the_first_frame():
    text = written(title="a <b> & c", comment="cubicsplat 1")
    assert "script" not in text and svg_is_ours(text.encode())
    grid = to_grid_clip(two_groups(), 1)
    own = render_scene(next(iter(grid.scenes(grid.groups[0], np.zeros(1)))))
    drawn = rerender(text.encode(), grid.width, grid.height).pixels[..., :3] / 255
    assert -10 * np.log10(np.square(own - drawn).mean()) > ALIKE_DB


@pytest.mark.parametrize(("plays", "said"), [(0, "indefinite"), (1, None), (3, "3")])
def test_how_often_it_plays(plays, said):
    animations = ANIMATION.findall(written([moving_scene(0)], plays=plays))
    assert animations
    for each in animations:
        assert (f'repeatCount="{said}"' in each) == (said is not None) and ("repeatCount" in each) == (plays != 1)
        assert ('fill="freeze"' in each) == (plays > 0)


def test_evenly_spaced_knots_need_no_times():
    group = moving_scene(0)
    assert "keyTimes" in written([group])
    for track in group.by_name.values():
        track.knots[:] = True
    text = written([group])
    assert text.count("keyTimes") < text.count("<animate") / 2


def test_frames_are_exact_within_their_own_time():
    group = moving_scene(0)
    exact = shown_at(group)
    assert exact[0] == group.times[0] and exact[-1] == pytest.approx(group.end)
    assert (exact >= group.times).all() and (exact[:-1] <= group.times[1:]).all()
    # The last frame of this one stays for long; stretched, the others would come too late.
    np.testing.assert_array_equal(shown_at(replace(group, end=group.end + 5.0)), group.times)


def test_what_cannot_be_written_is_refused():
    for name, bad in (("shapes", 1e8), ("shapes", np.nan), ("offsets", 1e8)):
        group = moving_scene(0)
        group.by_name[name].values[0, 0, 0] = bad
        with pytest.raises(InputError, match="px from the origin"):
            to_grid_clip([group], 1)


def level_db(page, wanted: np.ndarray) -> float:
    """PSNR of the page's upper left corner against a picture."""
    height, width = wanted.shape[:2]
    data = page.screenshot(clip={"x": 0, "y": 0, "width": width, "height": height})
    with Image.open(io.BytesIO(data)) as image:
        return float(-10 * np.log10(np.square(np.asarray(image.convert("RGB")) / 255 - wanted).mean()))


@pytest.mark.parametrize("mode", rest_slow(*Mode))
def test_chromium_plays_our_frames(browser, mode):
    clip = two_groups(mode)
    page = browser.new_page(viewport={"width": 200, "height": 100})

    def level_at(seconds: float, scene: Scene) -> float:
        page.evaluate(
            "t => { const s = document.querySelector('svg'); s.pauseAnimations(); s.setCurrentTime(t) }", seconds
        )
        return level_db(page, render_scene(scene))

    for plays in (0, 2):
        text = written(clip, plays=plays)
        grid = read_clip(text)
        page.set_content(f"<style>body{{margin:0}}svg{{display:block}}</style>{text[text.index('<svg') :]}")
        for turn, group in enumerate((*grid.groups, grid.groups[0])):
            times = np.linspace(group.begin + 1e-3, group.end - 1e-3, 4)
            for at, scene in zip(times, grid.scenes(group, times), strict=True):
                # The third time it is the first group again.
                assert level_at(at + grid.duration * (turn // 2), scene) > ALIKE_DB
    # It ends with its last frame.
    last = next(iter(grid.scenes(grid.groups[-1], np.array([grid.duration]))))
    assert level_at(2 * grid.duration + 1.0, last) > ALIKE_DB
    page.close()


def test_chromium_plays_it_in_an_image(browser, tmp_path):
    """No script runs there, and nobody can set its time: the pictures must be ours of some time, and another later."""
    clip = [moving_scene(0, seconds=0.3)]
    (tmp_path / "clip.svg").write_text(written(clip))
    (tmp_path / "page.html").write_text('<style>body{margin:0}</style><img src="clip.svg">')
    grid = to_grid_clip(clip, 1)
    times = np.linspace(0, grid.duration, 64)
    frames = [render_scene(scene) for scene in grid.scenes(grid.groups[0], times)]
    page = browser.new_page(viewport={"width": 200, "height": 100})
    page.goto((tmp_path / "page.html").as_uri())
    page.evaluate("document.images[0].decode()")  # else the first pictures may be blank
    seen: set[int] = set()
    while len(seen) < 4:  # the timeout of the tests ends it
        data = page.screenshot(clip={"x": 0, "y": 0, "width": grid.width, "height": grid.height})
        with Image.open(io.BytesIO(data)) as image:
            pixels = np.asarray(image.convert("RGB")) / 255
        errors = [np.square(pixels - frame).mean() for frame in frames]
        seen.add(int(np.argmin(errors)))
        assert -10 * np.log10(min(errors)) > ALIKE_DB
    page.close()


@pytest.mark.slow
def test_the_player_steps_and_plays(browser, tmp_path):
    pictures = [np.roll(smooth_pixels(40, 30), 4 * index, axis=1) for index in range(3)]
    animation = cubicsplat_cli.animate(pictures, fps=5, style="photo", curves=4, steps=20, threads=1)
    frames = clip_of_pictures(pictures, ClipRequest(fps=5)).frames()
    (tmp_path / "clip.html").write_bytes(player_page(animation.svg, animation.report, frames, "a <clip>"))
    page, said, asked = browser.new_page(), [], []
    page.on("console", lambda message: said.append(message.text))
    page.on("pageerror", lambda error: said.append(str(error)))
    page.on("request", lambda request: asked.append(request.url))
    page.goto((tmp_path / "clip.html").as_uri())
    assert page.locator("h1").text_content() == "a <clip>"
    now = page.locator(".now")
    before = now.text_content()
    page.wait_for_function("before => document.querySelector('.now').textContent !== before", arg=before)
    page.locator(".time").fill("0.3")
    assert (now.text_content(), page.locator(".frame").text_content()) == ("0.30 s", "frame 2 of 3")
    assert page.locator("[data-do=play]").text_content() == "Play"
    for button, frame in (("on", 3), ("on", 1), ("back", 3)):
        page.locator(f"[data-do={button}]").click()
        assert page.locator(".frame").text_content() == f"frame {frame} of 3"
    assert page.evaluate("document.querySelector('.animation svg').getCurrentTime()") == pytest.approx(0.4, abs=0.01)
    level = animation.report.quality.frames[2]["psnr_db"]
    assert page.locator(".level").text_content() == f"{level:.2f} dB"
    assert said == [] and all(url.startswith(("file:", "data:")) for url in asked)
    page.close()


@pytest.mark.parametrize("mode", Mode)
def test_lottie_read_back_by_its_own_package_says_the_same(mode):
    objects = pytest.importorskip("lottie.objects", reason="needs lottie: pip install lottie")
    clip = two_groups(mode)
    grid = to_grid_clip(clip, 1)
    animation = objects.Animation.load(json.loads(lottie(grid, fps=10.0, title="x")))
    assert (animation.width, animation.height, animation.frame_rate) == (grid.width, grid.height, 10)
    assert animation.out_point == pytest.approx(grid.duration * 10)
    for layer, group, moving in zip(animation.layers, grid.groups, clip, strict=False):
        assert (layer.in_point, layer.out_point) == pytest.approx((group.begin * 10, group.end * 10))
        exact = shown_at(moving)
        for at, scene in zip(exact * 10, grid.scenes(group, exact), strict=True):
            for index, shape in enumerate(layer.shapes):
                outline, paint, place = shape.shapes
                bezier, offset = outline.shape.get_value(at), place.position.get_value(at)
                shift = np.array([offset.x, offset.y])
                vertices, after, before = (
                    np.array([[point.x, point.y] for point in points])
                    for points in (bezier.vertices, bezier.out_tangents, bezier.in_tangents)
                )
                points = scene.points[index]
                np.testing.assert_allclose((vertices + shift) / 10, points[::3], atol=0.02)
                count = len(points[1::3])
                np.testing.assert_allclose((vertices + after + shift)[:count] / 10, points[1::3], atol=0.02)
                np.testing.assert_allclose(
                    np.roll(vertices + before + shift, -1, 0)[:count] / 10, points[2::3], atol=0.02
                )
                np.testing.assert_allclose([*paint.color.get_value(at)][:3], scene.colours[index], atol=2e-3)
                assert paint.opacity.get_value(at) / 100 == pytest.approx(scene.opacities[index], abs=2e-3)


def test_lottie_is_plain_json_with_our_mark(tmp_path: Path):
    grid = to_grid_clip(two_groups(), 1)
    document = json.loads(lottie(grid, fps=10.0, title="clip"))
    assert document["nm"] == "clip" and [layer["ty"] for layer in document["layers"]] == [4, 4, 1]
    from cubicsplat_cli.files.paths import is_ours

    (tmp_path / "clip.json").write_text(lottie(grid, fps=10.0))
    assert is_ours(tmp_path / "clip.json")
