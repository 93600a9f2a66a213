"""`benchmarks.metamorphic`: a tool that is not misled agrees in every way, and one that is, only in the others."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks import metamorphic, tools
from benchmarks.artwork.document import Document
from benchmarks.artwork.pixels import psnr

# Its edges lie on the borders of JPEG's blocks, so that they stay sharp.
DRAWING = '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 64 48"><path d="M16 16H48V32H16z" fill="{}"/></svg>'


def box_of(given: tools.Given) -> bytes:
    """The one box of a picture on a flat background, traced exactly."""
    pixels = tools.pixels_of(given)
    colours, background = pixels[..., :3].astype(int), pixels[0, 0, :3].astype(int)
    rows, columns = np.nonzero(np.abs(colours - background).max(axis=2) > 60)
    top, bottom, left, right = rows.min(), rows.max() + 1, columns.min(), columns.max() + 1
    fill = np.median(colours[top:bottom, left:right].reshape(-1, 3), axis=0).astype(int)
    height, width = pixels.shape[:2]
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}">'
        f'<rect width="{width}" height="{height}" fill="rgb({",".join(map(str, background))})"/>'
        f'<rect x="{left}" y="{top}" width="{right - left}" height="{bottom - top}" '
        f'fill="rgb({",".join(map(str, fill))})"/></svg>'
    ).encode()


def misled(pixels: np.ndarray) -> bytes:
    """More shapes on black, a wrong colour in a wider picture, and nothing of an upright one."""
    if pixels.shape[0] > pixels.shape[1]:
        raise ZeroDivisionError("upright")
    svg = box_of(pixels)
    if pixels[0, 0, 0] == 0:
        return svg.replace(b"</svg>", b'<circle r="0.1"/></svg>')
    return svg.replace(b"rgb(32", b"rgb(90") if pixels.shape[1] == 61 else svg


def brighter_file(given: tools.Given, by: int) -> bytes:
    """The box, brighter by so many levels if it comes as a file."""
    svg = box_of(given)
    if isinstance(given, np.ndarray):
        return svg
    return re.sub(rb"rgb\((\d+)", lambda found: b"rgb(%d" % min(int(found[1]) + by, 255), svg)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "box.svg").write_text(DRAWING.format("#2060a0"))
    return tmp_path


def test_an_exact_tool_agrees_in_every_way(run_benchmark, folder, monkeypatch):
    monkeypatch.setitem(tools.TOOLS, "ours", box_of)
    done = run_benchmark("metamorphic", folder, "--size", 64, "--json")
    pairs = json.loads(done.stdout)["pairs"]
    assert [pair["way"] for pair in pairs] == list(metamorphic.VARIATIONS)
    assert [pair for pair in pairs if not pair["agrees"]] == []
    assert all(pair["plain_delta_e"] == 0.0 and pair["shapes"] == 2 for pair in pairs)


def test_a_margin_hides_no_difference(run_benchmark, folder, monkeypatch):
    monkeypatch.setitem(tools.TOOLS, "ours", lambda pixels: box_of(pixels).replace(b"rgb(32", b"rgb(40"))
    done = run_benchmark("metamorphic", folder, "--size", 64, "--ways", "margin", "--json")
    (pair,) = json.loads(done.stdout)["pairs"]
    assert pair["delta_e"] == pytest.approx(pair["plain_delta_e"], rel=1e-3)
    assert pair["plain_delta_e"] > 0.1


def test_colours_that_a_jpeg_does_not_tell_are_no_difference(run_benchmark, tmp_path, monkeypatch):
    (tmp_path / "box.svg").write_text(DRAWING.format("#002000").replace("M16 16H48V32", "M16 16H64V48"))
    agree = []
    for off in (0, 9):
        monkeypatch.setitem(tools.TOOLS, "ours", lambda given, off=off: brighter_file(given, off))
        done = run_benchmark("metamorphic", tmp_path, "--size", 64, "--ways", "jpeg70", "--json")
        (pair,) = json.loads(done.stdout)["pairs"]
        agree.append(pair["agrees"])
        assert pair["delta_e"] > pair["plain_delta_e"] + metamorphic.ROUGH_DELTA_E
    assert agree == [True, False]


def test_a_tool_that_is_misled_differs_where_it_is(run_benchmark, folder, monkeypatch):
    monkeypatch.setitem(tools.TOOLS, "ours", misled)
    done = run_benchmark(
        "metamorphic", folder, "--size", 64, "--ways", "crop,flip,turn,inverted", "--markdown", "-q", code=1
    )
    ends = {line.split("|")[1].strip(): line.split("|")[-2].strip() for line in done.stdout.decode().splitlines()}
    assert (ends["box, crop"], ends["box, flip"], ends["box, inverted"]) == ("differs", "agrees", "differs")
    assert (ends["turn"], ends["flip"], ends["all ways"]) == ("0 of 1", "1 of 1", "1 of 4")
    assert done.stderr == b"cubicsplat: failed: box, turn: upright\n"


def test_fine_samples_are_the_area_and_linear_light_is_lighter():
    document = Document(DRAWING.format("#000").replace("M16 ", "M16.5 ").replace("H16z", "H16.5z").encode(), "x", 64)
    metamorphic.lay_over_white(document)
    area, linear = (metamorphic.VARIATIONS[name].draw(document) for name in ("area", "linear"))
    assert psnr(area, document.draw()) > 50
    assert (area[20, 16, 0], linear[20, 16, 0]) == (128, 188)
    assert (area[20, 20, 0], linear[2, 2, 0]) == (0, 255)


def test_wrong_usage_is_said(run_benchmark, folder):
    done = run_benchmark("metamorphic", folder, "--ways", "flip,sideways", code=2)
    assert b"--ways must be of margin, crop, flip" in done.stderr
