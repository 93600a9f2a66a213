"""`--init` and `--freeze`: a fit that begins with a drawing."""

from __future__ import annotations

import re

import numpy as np
import pytest
import torch
from cli_runs import strict_json
from PIL import Image
from test_fills import final
from test_fit import picture, settings

from cubicsplat_cli import vectorize
from cubicsplat_cli.errors import InputError
from cubicsplat_cli.photo.initial import warmed
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import FitSettings, Mode
from cubicsplat_cli.svg.scene_reader import read_svg

QUICK = ("--steps", 40, "--threads", 1, "--preset", "draft", "--style", "photo")


@pytest.fixture(scope="module")
def target() -> np.ndarray:
    """More detail than the curves can show."""
    small = np.random.default_rng(5).random((7, 10, 3), np.float32)
    return small.repeat(4, 0).repeat(4, 1)


@pytest.fixture(scope="module")
def first(target) -> Scene:
    return fit(target, settings()).scene


def level(found) -> float:
    return found.history[-1]["psnr_db"]


def test_refining_is_better_than_the_start_and_quicker_than_anew(target, first):
    refined = fit(target, settings(steps=60), inputs=FitInputs(start=first))
    assert refined.scene.curves <= first.curves
    assert final(target, refined.scene) > final(target, first) + 0.05


@pytest.mark.parametrize("steps", [1, 3])
def test_a_result_is_never_worse_than_its_start(target, first, steps):
    """Few steps with new curves in front do harm; what went before is kept."""
    found = fit(target, settings(steps=steps, curves=30), inputs=FitInputs(start=first))
    assert final(target, found.scene) >= final(target, first) - 1e-4


def test_growing_gives_more_curves_and_more_decibels(target, first):
    grown = fit(target, settings(curves=24, steps=60), inputs=FitInputs(start=first))
    assert grown.scene.curves > first.curves
    assert final(target, grown.scene) > final(target, first) + 1.0


def test_shrinking_keeps_the_curves_of_most_use(target, first):
    shrunk = fit(target, settings(curves=6, steps=60), inputs=FitInputs(start=first))
    anew = fit(target, settings(curves=6, steps=60))
    assert shrunk.scene.curves <= 6
    assert final(target, shrunk.scene) > final(target, anew.scene) - 0.5


@pytest.mark.parametrize("curves", [12, 8])
@pytest.mark.parametrize("mode", list(Mode))
def test_a_start_of_shorter_curves_is_refined_and_shrunk(target, mode, curves):
    """Curves that are seeded anew have more segments than those of the drawing, as with files of --max-bytes."""
    start = fit(target, settings(mode=mode, segments=1)).scene
    found = fit(target, settings(mode=mode, curves=curves, segments=3), inputs=FitInputs(start=start))
    assert found.replaced > 0
    found.scene.validate()
    if curves == 12:
        assert final(target, found.scene) > final(target, start)


@pytest.mark.parametrize("mode", list(Mode))
def test_frozen_curves_stay_as_they_are_behind_the_new_ones(target, mode):
    first = fit(target, settings(mode=mode)).scene
    found = fit(target, settings(mode=mode, curves=first.curves + 8), inputs=FitInputs(start=first, frozen=True)).scene
    assert found.curves > first.curves
    kept = slice(found.curves - first.curves, None)
    assert np.array_equal(found.points[kept], first.points)
    assert np.array_equal(found.colours[kept], first.colours)
    assert np.array_equal(found.opacities[kept], first.opacities)
    assert final(target, found) > final(target, first) + 0.3


def test_a_start_of_another_size_and_of_curves_of_different_lengths(target, first):
    """A drawing with a hole, read from a file, twice as large; the new curves have their own number of segments."""
    first = first.as_torch()
    ring = first.points[0]
    points = torch.zeros(2, 24, 2)
    points[0, :12], points[0, 12:] = ring, ring.flip(0) * 0.5
    points[1, :12] = first.points[1]
    ends = torch.tensor([[4, 8], [4, 4]], dtype=torch.int32)
    ragged = Scene(
        Mode.CLOSED, 40, 28, points, first.colours[:2], first.opacities[:2], first.half_widths[:2],
        first.background, ends,
    )  # fmt: skip
    found = fit(target, settings(curves=10), inputs=FitInputs(start=ragged.scaled(80, 56))).scene
    assert found.ring_ends is not None
    found.validate()
    assert final(target, found) > final(target, ragged) + 1.0
    for penalty in ("crossing_penalty", "spike_penalty"):
        judged = fit(target, settings(curves=10, **{penalty: 0.1}), inputs=FitInputs(start=ragged)).scene
        assert final(target, judged) > final(target, ragged) + 1.0


def test_a_start_without_a_background_and_a_picture_with_transparency(first):
    clear = picture(alpha=True)
    found = fit(clear, settings(), inputs=FitInputs(start=first)).scene
    assert found.background is None
    again = fit(picture(), settings(), inputs=FitInputs(start=found)).scene
    assert again.background is not None


def test_fills_are_not_a_start_for_strokes(target, first):
    with pytest.raises(InputError, match="has filled shapes; use --mode closed"):
        fit(target, settings(mode="open"), inputs=FitInputs(start=first))


def test_a_warm_recipe_is_the_usual_one_where_nothing_is_in_place():
    recipe = FitSettings().recipe
    assert warmed(recipe, 0.0) == recipe
    warm = warmed(recipe, 1.0)
    assert (warm.edge_start, warm.rate_points) == (recipe.edge_end, 0.5 * recipe.rate_points)


def test_the_real_command_refines_grows_and_freezes(target, tmp_path, run_cli):
    photo, before = tmp_path / "photo.png", tmp_path / "before.svg"
    Image.fromarray((target * 255).astype(np.uint8)).save(photo)
    run_cli("vectorize", photo, "-o", before, "--curves", 8, *QUICK)
    start = read_svg(before.read_bytes())
    levels = [strict_json(before.with_suffix(".json").read_bytes())["quality"]["svg"]["psnr_db"]]
    for options in (("--init", before), ("--init", before, "--curves", 16, "--freeze")):
        done = run_cli("vectorize", photo, "-o", tmp_path / "after.svg", *options, *QUICK, "--json", "-q")
        found = strict_json(done.stdout)
        assert found["settings"]["init"]["name"] == str(before)
        levels.append(found["quality"]["svg"]["psnr_db"])
    assert levels == sorted(levels)
    frozen = read_svg((tmp_path / "after.svg").read_bytes())
    assert np.allclose(frozen.points[-start.curves :], start.points, atol=1e-4)
    again = run_cli("vectorize", photo, "-o", tmp_path / "after.svg", *options, *QUICK, "--json", "-q")
    assert strict_json(again.stdout)["status"] == "unchanged"


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (("--init", "none.svg"), 1, "none.svg: no such file"),
        (("--init", "broken.svg"), 1, "broken.svg: is not well-formed XML"),
        (
            ("--init", "foreign.svg"),
            1,
            "the drawing foreign.svg has 9 x 9 px, another shape than the picture's",
        ),
        (("--init", "wide.svg"), 1, "the drawing wide.svg has 80 x 28 px, another shape than the picture's 40 x 28"),
        (
            ("--init", "same.svg", "--freeze", "--curves", 1),
            2,
            "the drawing's 1 curves are frozen, so that --curves 1 leaves none",
        ),
        (("--init", "same.svg", "--mode", "open"), 1, "the drawing to begin with has filled shapes; use --mode closed"),
        (("--freeze",), 2, "--freeze needs a drawing"),
        (("--init", "same.svg", "--style", "artwork"), 2, "--init is for photos"),
    ],
)
def test_what_is_no_beginning_is_said_in_one_line(photo, run_cli, monkeypatch, options, code, text):
    monkeypatch.chdir(photo.parent)
    shape = '<g id="curves" fill-rule="nonzero"><path d="M1 1c9 0 9 9 0 9 -9 0 -9 -9 0 -9z" fill="#ff0000"/></g></svg>'
    for name, size in (("wide", "80"), ("same", "40")):
        head = f'<svg xmlns="http://www.w3.org/2000/svg" width="{size}" height="28" viewBox="0 0 {size} 28">'
        (photo.parent / f"{name}.svg").write_text(head + shape)
    (photo.parent / "broken.svg").write_text((photo.parent / "same.svg").read_text()[:150])
    foreign = '<svg xmlns="http://www.w3.org/2000/svg" width="9" height="9" viewBox="0 0 9 9"><circle r="3"/></svg>'
    (photo.parent / "foreign.svg").write_text(foreign)
    done = run_cli("vectorize", photo, "-q", "--steps", 3, "--threads", 1, *options, code=code)
    assert done.stderr.count(b"\n") == 1
    assert text in re.sub(r"\s+", " ", done.stderr.decode())


def test_the_library_begins_with_a_result(target):
    pixels = (target * 255).astype(np.uint8)
    short = {"style": "photo", "steps": 30, "threads": 1, "preset": "draft"}
    before = vectorize(pixels, curves=8, **short)
    after = vectorize(pixels, init=before, **short)
    assert after.report.quality.svg.psnr_db >= before.report.quality.svg.psnr_db
    assert after.report.settings["init"]["name"] == "the SVG"
