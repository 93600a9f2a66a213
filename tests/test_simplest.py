"""`--max-bytes`, `--max-nodes` and `--target-psnr` of drawings: ever simpler versions of one."""

from __future__ import annotations

import gzip
from dataclasses import replace
from itertools import combinations, pairwise
from pathlib import Path

import numpy as np
import pytest
from conftest import rest_slow
from hypothesis import given
from hypothesis import strategies as st
from image_files import by_resvg

from cubicsplat_cli import vectorize
from cubicsplat_cli.artwork.finish.simpler import apart
from cubicsplat_cli.artwork.vectorize import versions
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.pipeline.artwork import drawn_outlines, within_budget
from cubicsplat_cli.pipeline.vectorize import task_of
from cubicsplat_cli.progress import StageTimer, Work, under_way
from cubicsplat_cli.svg.markup import minified

SHAPES = """<rect width="128" height="128" fill="#fff"/>
<path d="M8 60C8 10 60 10 64 40C68 12 118 12 120 58C118 100 70 104 64 84C58 104 12 104 8 60Z" fill="#2a6"/>
<circle cx="40" cy="56" r="14" fill="#fc3"/><circle cx="88" cy="56" r="9" fill="#fc3"/>
<path d="M30 112C44 104 60 120 74 112S100 104 110 114L108 120C96 112 90 124 74 118S44 112 32 118Z" fill="#c24"/>
<rect x="20" y="4" width="5" height="4" fill="#246"/><circle cx="110" cy="8" r="3" fill="#246"/>"""


@pytest.fixture(scope="module")
def picture() -> np.ndarray:
    svg = f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 128 128">{SHAPES}</svg>'
    return np.asarray(by_resvg(svg).convert("RGB"))


@pytest.fixture(scope="module")
def simpler_ones(picture):
    target = picture.astype(np.float32) / 255.0
    return list(versions(target))


def test_versions_get_simpler_down_to_one_shape_and_further_from_the_picture(simpler_ones):
    sizes = [(drawing.segments, len(drawing.shapes)) for drawing in simpler_ones]
    assert len(sizes) >= 6 and sizes[0][1] >= 6 and sizes[-1][1] == 1
    assert all(after != before and after[0] <= before[0] for before, after in pairwise(sizes))


def test_what_is_small_goes_before_what_is_large(simpler_ones):
    """The first shapes to go are the three smallest; the largest stay longest."""
    areas = [sorted(_box_area(shape) for shape in drawing.shapes) for drawing in simpler_ones]
    kept = next(each for each in areas if len(each) <= len(areas[0]) - 2)
    assert min(kept) > areas[0][1]


def _box_area(shape) -> float:
    points = np.concatenate([outline.ring().anchors for outline in shape.outlines])
    return float(np.prod(np.ptp(points, axis=0)))


@pytest.mark.parametrize(("most", "less"), rest_slow(("700gz", "450gz"), ("1400", "900")))
def test_a_drawing_has_as_many_bytes_as_it_may_and_is_nearer_with_more(picture, most, less):
    levels = []
    for amount in (most, less):
        result = vectorize(picture, style="artwork", max_bytes=amount)
        data = result.svg.encode()
        limit = int(amount.removesuffix("gz"))
        size = len(gzip.compress(data, 9)) if amount.endswith("gz") else len(data)
        assert 0.6 * limit < size <= limit
        assert ("<title>" in result.svg) == (not amount.endswith("gz"))
        levels.append(result.report.quality.svg.psnr_db)
    assert levels[0] > levels[1] > 15.0


def test_a_budget_alone_does_not_decide_the_style(picture):
    report = vectorize(picture, max_bytes=1500, threads=1).report
    assert report.style == "artwork" and report.output.bytes <= 1500


@pytest.mark.slow
def test_nodes_are_bounded(picture):
    usual = vectorize(picture, style="artwork", measure=False).report
    bounded = vectorize(picture, max_nodes=16, measure=False).report
    assert usual.segments > 24 and bounded.segments <= 16
    assert (bounded.style, bounded.settings["max_nodes"]) == ("artwork", 16)


def test_the_simplest_drawing_that_reaches_a_level(picture):
    report = vectorize(picture, style="artwork", target_psnr=28).report
    usual = vectorize(picture, style="artwork").report
    assert report.quality.svg.psnr_db >= 28.0 and report.segments < usual.segments
    far = vectorize(picture, style="artwork", target_psnr=60).report
    assert far.segments == usual.segments
    assert any("of the 60 dB asked for" in note for note in far.notes)


def test_what_fits_in_nothing_says_what_it_needs(picture):
    with pytest.raises(InputError, match=r"not even the simplest drawing fits; allow at least \d+ bytes"):
        vectorize(picture[:40, :40], style="artwork", max_bytes="100")


def test_where_the_time_is_up_the_drawing_so_far_says_what_it_has(picture):
    task = task_of(as_picture(picture), request_of({"style": "artwork", "max_bytes": 900}), StageTimer())
    work = Work()
    with under_way(work):
        drawings = versions(task.target.target())
        made = replace(drawn_outlines(task_of(task.picture, request_of({"style": "artwork"}), StageTimer())), notes=[])
        next(drawings)
        work.stopped = True
        assert list(drawings) == []
        only = within_budget(task, iter([made]))
    assert [note.partition(" it has ")[0] for note in only.notes] == ["the time was too short to simplify it:"]


@given(st.lists(st.tuples(*[st.integers(0, 30)] * 4), min_size=1, max_size=30))
def test_groups_hold_each_box_once_and_none_that_overlap(corners):
    boxes = np.array([[min(a, c), min(b, d), max(a, c) + 1, max(b, d) + 1] for a, b, c, d in corners])
    groups = apart(boxes, range(len(boxes)))
    assert sorted(number for group in groups for number in group) == list(range(len(boxes)))
    for group in groups:
        for one, other in combinations(boxes[group], 2):
            assert (np.maximum(one[:2], other[:2]) >= np.minimum(one[2:], other[2:])).any()


def test_lean_documents_keep_what_is_seen():
    svg = """<?xml version="1.0" encoding="UTF-8"?>
<svg xmlns="http://www.w3.org/2000/svg" width="8" height="4" viewBox="0 0 8 4">
<!-- cubicsplat -->
<title>a
b</title>
<linearGradient id="a"><stop/></linearGradient>
<g id="red">
<path id="red-2" d="M0 0h8v4z" fill="url(#a)"/>
</g>
</svg>
"""
    assert minified(svg) == (
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 8 4"><linearGradient id="a"><stop/></linearGradient>'
        '<g><path d="M0 0h8v4z" fill="url(#a)"/></g></svg>'
    )


def test_a_photo_that_has_to_fit_too_does_not_replace_the_drawing():
    """In 700 bytes, a photo has two curves."""
    made = vectorize(Path(__file__).parents[1] / "samples" / "logo.png", max_bytes=700)
    assert made.report.style == "artwork"
    assert len(made.svg.encode()) <= 700
