"""The SVG contract: what the writer makes, that the reader gives it back exactly, and what it refuses."""

from __future__ import annotations

import dataclasses
import re
import time
from xml.etree import ElementTree

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scenes import PAPER, random_scene

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.markup import format_number
from cubicsplat_cli.svg.quantise import MAX_COORDINATE
from cubicsplat_cli.svg.scene_reader import quantise_scene, read_svg
from cubicsplat_cli.svg.scene_writer import path_strings, write_svg

COMMENT = "cubicsplat 9.9.9, seed 7, settings 0123456789ab"
NAMESPACE = "{http://www.w3.org/2000/svg}"
NUMBER = re.compile(r"-?(?:\d+\.?\d*|\.\d+)")


def written(scene: Scene, precision: int = 2) -> str:
    return write_svg(scene, precision=precision, title="a picture", comment=COMMENT)


def group_of(text: str) -> ElementTree.Element:
    return ElementTree.fromstring(text).find(f"{NAMESPACE}g")


def paths_of(text: str) -> list[ElementTree.Element]:
    return group_of(text).findall(f"{NAMESPACE}path")


def unit_of(text: str) -> float:
    """Pixels of one unit of the paths."""
    transform = group_of(text).get("transform", "scale(1)")
    return float(re.fullmatch(r"scale\(([\d.]+)\)", transform)[1])


def assert_same(first: Scene, second: Scene) -> None:
    """Every field equal to the last bit."""
    for name in ("mode", "width", "height", "background"):
        assert getattr(first, name) == getattr(second, name), name
    for name in ("points", "colours", "opacities", "half_widths"):
        assert np.array_equal(getattr(first, name), getattr(second, name)), name
        assert getattr(first, name).dtype == np.float32


def independent_points(d: str) -> np.ndarray:
    """(K, 2) points of a path by plain float arithmetic, end point of a closed path included."""
    commands = re.findall(r"([A-Za-z])([^A-Za-z]*)", d)
    assert commands[0][0] == "M"
    points = [np.array([float(n) for n in NUMBER.findall(commands[0][1])])]
    for letter, text in commands[1:]:
        numbers = np.array([float(n) for n in NUMBER.findall(text)]).reshape(-1, 3, 2)
        for three in numbers:
            points.extend(three + (points[-1] if letter == "c" else 0.0))
        assert letter in "cCz"
    return np.stack(points)


def small_curves(count: int, *, opaque: bool, radius: float = 4.0) -> Scene:
    """Closed curves of 3 segments whose sizes spread as those of a fitted photo, on 768 x 512."""
    rng = np.random.default_rng(5)
    sizes = radius * np.exp(rng.normal(0.0, 0.6, count))
    turn = np.arange(9) * 2 * np.pi / 9
    ring = 1.2 * np.stack([np.cos(turn), np.sin(turn)], -1) + rng.normal(0.0, 0.4, (count, 9, 2))
    points = rng.uniform(0, 1, (count, 1, 2)) * [768, 512] + sizes[:, None, None] * ring
    return Scene(
        mode=Mode.CLOSED,
        width=768,
        height=512,
        points=torch.tensor(points, dtype=torch.float32),
        colours=torch.tensor(rng.random((count, 3)), dtype=torch.float32),
        opacities=torch.ones(count) if opaque else torch.tensor(rng.random(count), dtype=torch.float32) * 0.99,
        half_widths=torch.zeros(count),
        background=PAPER,
    )


@pytest.mark.parametrize(
    ("value", "precision", "text"),
    [
        (0, 2, "0"), (5, 2, ".05"), (50, 2, ".5"), (-50, 2, "-.5"), (100, 2, "1"), (1234, 2, "12.34"),
        (-1230, 2, "-12.3"), (1000, 2, "10"), (7, 0, "7"), (-70, 0, "-70"), (1, 6, ".000001"),
    ],
)  # fmt: skip
def test_numbers_are_trimmed(value, precision, text):
    assert format_number(value, precision) == text


@given(value=st.integers(-(10**12), 10**12), precision=st.integers(0, 6))
def test_numbers_keep_their_value_and_are_as_short_as_can_be(value, precision):
    text = format_number(value, precision)
    assert float(text) == value / 10**precision
    assert re.fullmatch(r"0|-?(?:[1-9]\d*(?:\.\d*[1-9])?|\.\d*[1-9])", text)


@st.composite
def scenes(draw) -> Scene:
    """Scenes of every mode and size, coordinates of all magnitudes, far off the canvas or exactly on it."""
    mode = draw(st.sampled_from(list(Mode)))
    segments, count = draw(st.integers(1, 5)), draw(st.integers(1, 6))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = draw(st.sampled_from([1e-4, 0.3, 30.0, 1000.0, 1e5]))
    shape = (count, 3 * segments + (mode is Mode.OPEN), 2)
    points = rng.normal(0.0, scale, shape)
    points[rng.random(shape) < 0.2] = draw(st.sampled_from([0.0, 0.5, -1.0, 768.0, 0.005]))
    some = draw(st.sampled_from([0.0, 0.0004, 0.5, 0.9996, 1.0]))
    background = draw(st.sampled_from([None, PAPER, (1.0, 0.0, 0.2)]))
    widths = rng.random(count) * draw(st.sampled_from([0.0, 0.02, 3.0, 500.0]))
    return Scene(
        mode=mode,
        width=draw(st.integers(1, 5000)),
        height=draw(st.integers(1, 5000)),
        points=torch.tensor(points, dtype=torch.float32),
        colours=torch.tensor(rng.random((count, 3)), dtype=torch.float32),
        opacities=torch.tensor(np.where(rng.random(count) < 0.5, some, rng.random(count)), dtype=torch.float32),
        half_widths=torch.tensor(widths if mode is Mode.OPEN else 0 * widths, dtype=torch.float32),
        background=background,
    )


@given(scene=scenes(), precision=st.integers(0, 6))
def test_reader_gives_back_exactly_the_rounded_scene(scene, precision):
    quantised = quantise_scene(scene, precision)
    assert_same(quantised, read_svg(written(scene, precision)))
    assert np.array_equal(quantised.points, rounded(torch.tensor(quantised.points), 10**precision))
    assert np.array_equal(quantised.colours, rounded(scene.colours, 255))
    assert np.array_equal(quantised.opacities, rounded(scene.opacities, 1000))
    assert np.array_equal(quantised.half_widths, rounded(2 * scene.half_widths, 10 ** max(precision, 2)) / 2)
    for asked, kept in zip(scene.points.double(), quantised.as_torch().points.double(), strict=True):
        allowed = 10.0**-precision / 2 + 1e-6 * kept.abs()
        ways = descriptions(asked, closed=scene.mode is Mode.CLOSED)
        assert any((torch.abs(kept - way) <= allowed).all() for way in ways)


def rounded(values: torch.Tensor, steps: int) -> np.ndarray:
    """The nearest multiples of 1 / steps, float32."""
    return (np.rint(values.double().numpy() * steps) / steps).astype(np.float32)


def descriptions(points: torch.Tensor, *, closed: bool) -> list[torch.Tensor]:
    """Every sequence of control points, (K, 2) each, that draws the same curve."""
    if not closed:
        return [points, points.flip(0)]
    turned = [points.roll(-3 * first, 0) for first in range(len(points) // 3)]
    return [way for ring in turned for way in (ring, torch.cat([ring[:1], ring[1:].flip(0)]))]


@pytest.mark.parametrize("mode", list(Mode))
def test_every_curve_is_written_in_its_shortest_description(mode):
    rng = np.random.default_rng(8)
    scene = random_scene(mode, curves=40, width=900, height=700)
    scene.points += torch.tensor(rng.normal(0.0, 60.0, (40, 1, 2)), dtype=torch.float32)
    chosen = [len(path.get("d")) for path in paths_of(written(scene))][::-1]
    grid = np.rint(scene.points.double().numpy() * 100).astype(np.int64)
    shorter_than_given = 0
    for points, length in zip(grid, chosen, strict=True):
        ways = [way.numpy() for way in descriptions(torch.tensor(points), closed=mode is Mode.CLOSED)]
        lengths = [len(path_strings(way[None], closed=mode is Mode.CLOSED)[0]) for way in ways]
        assert length <= min(lengths) + 1, "the estimate may err by a letter, not by more"
        shorter_than_given += length < lengths[0]
    assert shorter_than_given > 5


@given(scene=scenes(), precision=st.integers(0, 4))
def test_relative_coordinates_do_not_drift(scene, precision):
    wanted = quantise_scene(scene, precision).points.astype(np.float64)[::-1]
    text = written(scene, precision)
    assert unit_of(text) == pytest.approx(10.0**-precision)
    for path, points in zip(paths_of(text), wanted, strict=True):
        found = independent_points(path.get("d")) * unit_of(text)
        if scene.mode is Mode.CLOSED:
            np.testing.assert_allclose(found[-1], found[0], atol=1e-6 * (1 + np.abs(found).max()))
            found = found[:-1]
        np.testing.assert_allclose(found, points, atol=1e-6 * (1 + np.abs(points).max()))


@pytest.mark.parametrize("mode", list(Mode))
def test_document_follows_the_contract(mode):
    scene = random_scene(mode, curves=7, width=60, height=40, background=(1.0, 0.5, 0.0))
    scene.opacities[2] = 1.0
    scene.opacities[4] = 0.25
    text = written(scene)
    root = ElementTree.fromstring(text)
    assert root.tag == f"{NAMESPACE}svg"
    assert (root.get("width"), root.get("height"), root.get("viewBox")) == ("60", "40", "0 0 60 40")
    assert root.findtext(f"{NAMESPACE}title") == "a picture"
    assert f"<!-- {COMMENT} -->" in text
    assert [child.tag.removeprefix(NAMESPACE) for child in root] == ["title", "rect", "g"]
    rect, group = root[1], root[2]
    assert (rect.get("fill"), rect.get("width"), rect.get("height")) == ("#ff8000", "60", "40")
    closed = mode is Mode.CLOSED
    shared = {"fill-rule": "nonzero"}
    if not closed:
        shared = {"fill": "none", "stroke-linecap": "round", "stroke-linejoin": "round"}
    assert group.attrib == {"id": "curves", "transform": "scale(.01)", **shared}
    assert rect.get("id") == "background"
    paint = "fill" if closed else "stroke"
    assert len(group) == 7
    for path, index in zip(group, reversed(range(7)), strict=True):
        red, green, blue = (round(255 * float(value)) for value in scene.colours[index])
        assert path.get(paint) == f"#{red:02x}{green:02x}{blue:02x}", "the front must be drawn last"
        assert path.get("d").endswith("z") == closed
        assert ("stroke-width" in path.attrib) == (not closed)
    assert f"{paint}-opacity" not in group[7 - 1 - 2].attrib
    assert group[7 - 1 - 4].get(f"{paint}-opacity") == ".25"
    if not closed:
        width = float(group[-1].get("stroke-width")) * unit_of(text)
        assert width == pytest.approx(2 * float(scene.half_widths[0]), abs=0.005)


def test_without_background_nothing_lies_behind_the_curves():
    root = ElementTree.fromstring(written(random_scene(Mode.CLOSED, background=None)))
    assert [child.tag.removeprefix(NAMESPACE) for child in root] == ["title", "g"]


@pytest.mark.parametrize(("opaque", "limit"), [(True, 111), (False, 131)])
def test_small_closed_curves_of_three_segments_are_compact(opaque, limit):
    scene = small_curves(512, opaque=opaque)
    paths = [line for line in written(scene).splitlines() if line.startswith("<path")]
    assert len(paths) == 512
    assert np.mean([len(line) + 1 for line in paths]) <= limit


@pytest.mark.parametrize("mode", list(Mode))
def test_an_opacity_that_all_curves_have_is_said_once(mode):
    paint = "fill" if mode is Mode.CLOSED else "stroke"
    scene = small_curves(3, opaque=False)
    if mode is Mode.OPEN:
        scene = dataclasses.replace(scene, mode=mode, points=scene.points[:, :4], half_widths=torch.ones(3))
    alike = dataclasses.replace(scene, opacities=torch.full((3,), 0.541))
    text = written(alike)
    assert group_of(text).get(f"{paint}-opacity") == ".541"
    assert not [path for path in paths_of(text) if path.get(f"{paint}-opacity")]
    assert_same(read_svg(text), quantise_scene(alike, 2))
    one_differs = dataclasses.replace(scene, opacities=torch.tensor([0.541, 0.541, 0.25]))
    assert group_of(written(one_differs)).get(f"{paint}-opacity") is None
    assert_same(read_svg(written(one_differs)), quantise_scene(one_differs, 2))
    other = "stroke" if mode is Mode.CLOSED else "fill"
    with pytest.raises(InputError, match=f"unexpected attribute '{other}-opacity'"):
        read_svg(text.replace(f' {paint}-opacity="', f' {other}-opacity="'))


def test_each_cubic_takes_the_shorter_form():
    # Near the origin absolute numbers are shorter, far from it relative ones; both occur in one path.
    points = torch.tensor(
        [[[900.0, 900.0], [1, 1], [2, 3], [3, 4], [4, 5], [5, 6], [901, 902], [902, 903], [901, 904]]]
    )
    scene = Scene(Mode.CLOSED, 999, 999, points, torch.zeros(1, 3), torch.ones(1), torch.zeros(1), None)
    text = written(scene, 0)
    (path,) = paths_of(text)
    assert unit_of(text) == 1
    assert path.get("d") == "M3 4c1 1 2 2 898 898 1 1 0 2-1-2C1 1 2 3 3 4z"


def test_stroke_widths_keep_two_decimals_at_low_precision():
    scene = random_scene(Mode.OPEN, curves=4, half_width=(0.1, 0.2))
    quantised = quantise_scene(scene, 0)
    assert (quantised.half_widths > 0.09).all()
    assert np.array_equal(quantised.points, quantised.points.round())
    assert_same(read_svg(written(scene, 0)), quantised)


@pytest.mark.parametrize(
    "title",
    ["a & b <script>alert(1)</script>", "control\x01\x1f\x7f", "undecodable \udcff", 'quote " -- -->', ""],
)
def test_any_title_and_comment_give_well_formed_xml(title):
    text = write_svg(random_scene(Mode.CLOSED), title=title, comment=f"x -- {title}---")
    text.encode("utf-8")
    root = ElementTree.fromstring(text)
    assert [child.tag for child in root] == [f"{NAMESPACE}title", f"{NAMESPACE}g"]
    assert read_svg(text).curves == 6


@pytest.mark.parametrize("name", ["points", "colours", "opacities", "half_widths"])
@pytest.mark.parametrize("value", [float("nan"), float("inf"), -float("inf")])
def test_non_finite_values_name_the_curve(name, value):
    scene = random_scene(Mode.OPEN, curves=5)
    getattr(scene, name)[3] = value
    with pytest.raises(InputError, match="curve 3"):
        written(scene)


def test_points_far_outside_are_refused_by_curve():
    scene = random_scene(Mode.CLOSED, curves=5)
    scene.points[1, 2, 0] = 1.5 * MAX_COORDINATE
    with pytest.raises(InputError, match=r"curve 1 .*control points"):
        written(scene)


@pytest.mark.parametrize("precision", [-1, 7, 2.5, True, "2"])
def test_precision_out_of_range_is_a_usage_error(precision):
    with pytest.raises(UsageError, match="precision"):
        written(random_scene(Mode.CLOSED), precision)
    with pytest.raises(UsageError, match="precision"):
        quantise_scene(random_scene(Mode.CLOSED), precision)


def test_writing_and_reading_a_thousand_curves_is_quick():
    """Each takes a fifth of this."""
    scene = random_scene(Mode.CLOSED, curves=1024, segments=4, width=768, height=512)
    started = time.process_time()
    text = written(scene)
    assert time.process_time() - started < 1.0
    started = time.process_time()
    assert read_svg(text).curves == 1024
    assert time.process_time() - started < 1.0


def good_svg() -> str:
    return written(random_scene(Mode.CLOSED, curves=2, background=PAPER))


def with_path(d: str) -> str:
    return re.sub(r' d="[^"]*"', f' d="{d}"', good_svg())


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "well-formed"),
        ("not xml", "well-formed"),
        (good_svg()[:-40], "well-formed"),
        ("<svg/>", "width and height"),
        ("<html/>", "<html>"),
        (good_svg().replace("<title>", "<desc/><title>"), "<desc>"),
        (good_svg().replace("<svg", "<!DOCTYPE svg><svg", 1), "DOCTYPE"),
        (good_svg().replace("<svg", '<!DOCTYPE svg [<!ENTITY a "b">]><svg', 1), "DOCTYPE"),
        (good_svg().replace("</g>", '<circle r="3"/></g>'), "<circle>"),
        (good_svg().replace("<path", '<path transform="scale(2)"', 1), "transform"),
        (good_svg().replace("0 0 24 20", "0 0 48 20"), "viewBox"),
        (good_svg().replace("nonzero", "evenodd"), "evenodd"),
        (re.sub(r'fill="#\w+" fill-op', 'fill="red" fill-op', good_svg()), "#rrggbb"),
        (re.sub('fill-opacity="[^"]*"', 'fill-opacity="1.5"', good_svg()), "1.5"),
        (re.sub("<path.*", "", good_svg()), "no curves"),
        (with_path(""), "without data"),
        (with_path("M1 2c1 2 3 4 5 6"), "end with z"),
        (with_path("M1 2c1 2 3 4 5 6z"), "return to its start"),
        (with_path("M1 2c1 2 3 4 0 z"), "lacks a number of c"),
        (with_path("M1 2z"), "cubic"),
        (with_path("M1 2l1 2z"), "other than M"),
        (with_path("M1 2c1e9 2 3 4 0 0z"), "4000000 px from the origin"),
        (with_path("M1 2c1 2 3 # 0 0z"), "cannot be read"),
        (with_path("M1 2c1 2 3 " + "4" * 40 + " 0 0z"), "4000000 px from the origin"),
    ],
)
def test_reader_refuses_what_we_did_not_write(text, said):
    with pytest.raises(InputError, match=said):
        read_svg(text)


def test_reader_takes_curves_of_different_lengths():
    one, two = (written(random_scene(Mode.CLOSED, curves=1, segments=n)) for n in (2, 3))
    path = next(line for line in two.splitlines() if line.startswith("<path"))
    assert read_svg(one.replace("</g>", path + "</g>")).ring_ends.tolist() == [[3], [2]]


def test_reader_refuses_files_over_the_size_limit(monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.svg.own.MAX_OWN_BYTES", 500)
    with pytest.raises(InputError, match="500"):
        read_svg(good_svg())


def test_reader_refuses_a_curve_without_end():
    with pytest.raises(InputError, match="has path data of more than 500000 commands"):
        read_svg(with_path("M1 2" + "c1 2 3-4 0 0" * 500_000))


def test_reader_takes_commas_newlines_and_plus_signs():
    loose = read_svg(with_path("M 1,2\n C +2 4,\t4 -2  1.0 2.00 Z"))
    assert_same(loose, read_svg(with_path("M1 2c1 2 3-4 0 0z")))
    wanted = torch.tensor([[1.0, 2.0], [2.0, 4.0], [4.0, -2.0]]) / 100
    assert np.allclose(loose.points[0], wanted)


def test_reader_takes_files_in_pixels_without_a_transform_or_names():
    """As version 0.1.0 wrote them at first."""
    text = re.sub(r' (?:id="\w+"|transform="[^"]+")', "", with_path("M1.5 2c1 2 3-4 0 0z"))
    assert "transform" not in text
    assert read_svg(text).points[0].tolist() == [[1.5, 2.0], [2.5, 4.0], [4.5, -2.0]]


def test_scene_with_gradients_is_written():
    scene = random_scene(Mode.CLOSED)
    tracked = dataclasses.replace(scene, points=scene.points.clone().requires_grad_())
    assert written(tracked) == written(scene)
