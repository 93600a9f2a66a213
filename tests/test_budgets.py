"""`--max-bytes` and `--target-psnr`: the number of curves that fits, by growing and shrinking one fit."""

from __future__ import annotations

import gzip

import numpy as np
import pytest
from cli_runs import strict_json
from conftest import ctrl_c

from cubicsplat_cli import vectorize
from cubicsplat_cli.errors import UsageError
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.options import parse_bytes
from cubicsplat_cli.pipeline import budget
from cubicsplat_cli.svg.scene_reader import read_svg
from cubicsplat_cli.svg.scene_writer import bytes_by_curve, write_svg

SHORT = {"steps": 60, "threads": 1, "preset": "draft", "style": "photo"}
OPTIONS = ("--steps", 60, "--threads", 1, "--preset", "draft", "--style", "photo", "--json", "-q")


@pytest.fixture(scope="module")
def noisy() -> np.ndarray:
    """More detail than some kilobytes can show."""
    small = np.random.default_rng(5).integers(0, 256, (14, 20, 3), np.uint8)
    return small.repeat(4, 0).repeat(4, 1)


@pytest.mark.parametrize("most", [2500, 9000])
def test_a_file_has_as_many_bytes_as_it_may_and_never_more(noisy, most):
    result = vectorize(noisy, max_bytes=most, **SHORT)
    assert 0.97 * most <= len(result.svg.encode()) <= most
    assert result.report.output.bytes == len(result.svg.encode())
    assert result.report.timing.steps == SHORT["steps"]
    assert (result.report.style, result.report.settings["max_bytes"]) == ("photo", most)


def test_with_svgz_the_compressed_bytes_count(noisy_file, run_cli):
    for options, name in ((("--svgz",), "noisy.svgz"), (("-o", "x.svgz"), "x.svgz")):
        options = [str(noisy_file.parent / o) if o.startswith("x") else o for o in options]
        done = run_cli("vectorize", noisy_file, *OPTIONS, "--max-bytes", "2k", *options)
        data = (noisy_file.parent / name).read_bytes()
        assert 0.97 * 2000 <= len(data) <= 2000
        assert len(gzip.decompress(data)) > 2500
        assert strict_json(done.stdout)["output"]["bytes"] == len(data)
    again = run_cli("vectorize", noisy_file, *OPTIONS, "--max-bytes", "2000", *options)
    assert strict_json(again.stdout)["status"] == "unchanged"


def test_a_byte_gives_more_where_bytes_are_the_budget(noisy):
    """The same bytes with the usual decimals and segments."""
    usual = vectorize(noisy, curves=24, **SHORT)
    within = vectorize(noisy, max_bytes=len(usual.svg.encode()), **SHORT)
    assert within.report.quality.svg.psnr_db > usual.report.quality.svg.psnr_db + 0.3
    assert within.scene.curves > usual.scene.curves


def test_a_file_has_as_many_decibels_as_are_asked_for(noisy):
    result = vectorize(noisy, target_psnr=18, **SHORT)
    assert 18.0 <= result.report.quality.svg.psnr_db <= 18.2
    assert not [note for note in result.report.notes if "asked for" in note]
    assert result.report.timing.steps <= 2 * SHORT["steps"]


@pytest.mark.slow
def test_a_fit_that_ends_below_the_level_grows_until_it_has_it(noisy, monkeypatch):
    """Where the looks take it that far more is left to rise than is."""
    monkeypatch.setattr(budget, "LOOKS", ((0.5, 3.0),))
    result = vectorize(noisy, target_psnr=17, **SHORT)
    assert 17.0 <= result.report.quality.svg.psnr_db <= 17.2
    assert SHORT["steps"] < result.report.timing.steps <= 2 * SHORT["steps"]


def test_what_cannot_be_reached_is_said_with_what_was(noisy):
    result = vectorize(noisy, target_psnr=59, **SHORT | {"steps": 4})
    reached = result.report.quality.svg.psnr_db
    assert reached < 59
    assert result.report.notes[-1] == f"reached {reached:.2f} dB of the 59 dB asked for; allow more --steps"
    hurried = vectorize(noisy, target_psnr=59, time_limit=0.2, **SHORT)
    assert hurried.report.notes[-1].endswith("dB of the 59 dB asked for; allow a longer --time-limit")


def test_not_even_one_curve_is_one_line(noisy_file, run_cli):
    done = run_cli("vectorize", noisy_file, *OPTIONS, "--max-bytes", 300, code=1)
    assert done.stderr.count(b"\n") == 1
    assert b"not even one curve fits into 300 bytes; allow at least" in done.stderr
    least = int(done.stderr.split(b"at least")[1])
    run_cli("vectorize", noisy_file, *OPTIONS, "--max-bytes", least + 60)


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("--max-bytes", "lots"), "--max-bytes must be an amount of bytes such as 20k, 1.5M or 400gz, not 'lots'"),
        (("--max-bytes", "0"), "--max-bytes must be an amount of bytes"),
        (("--target-psnr", "99"), "--target-psnr must be a number from 1 to 60"),
        (("--target-psnr", "nan"), "--target-psnr must be a number from 1 to 60"),
        (("--max-bytes", "9k", "--target-psnr", "30"), "--max-bytes and --target-psnr are two budgets"),
        (("--max-bytes", "9k", "--curves", "30"), "--max-bytes finds the number of curves itself"),
        (("--target-psnr", "30", "--style", "pixel"), "--target-psnr leaves details out, which pixel art keeps"),
        (("--max-nodes", "30", "--style", "photo"), "--max-nodes is for artwork"),
    ],
)
def test_senseless_budgets_are_refused(photo, run_cli, options, text):
    run_cli("vectorize", photo, *options, code=2, error=text)


def test_amounts():
    assert [parse_bytes(text) for text in ("20k", "20 kB", "1.5M", "512", 7)] == [20_000, 20_000, 1_500_000, 512, 7]
    for wrong in ("", "-1", "1e9", "2G", "0.2", True, "9" * 30):
        with pytest.raises(UsageError, match="amount of bytes"):
            parse_bytes(wrong)


@pytest.mark.parametrize(
    ("options", "segments"),
    [({}, 4), ({"max_bytes": "9k"}, 2), ({"max_bytes": "9k", "segments": 5}, 5), ({"max_bytes": 9, "mode": "open"}, 3)],
)
def test_a_file_of_few_bytes_has_the_segments_that_give_most_for_a_byte(options, segments):
    assert request_of(options).settings.segments == segments


@pytest.mark.parametrize("mode", ["closed", "open"])
def test_bytes_of_curves_add_up_to_those_of_the_file(noisy, mode):
    scene = vectorize(noisy, mode=mode, curves=20, measure=False, **SHORT).scene
    sizes, whole = bytes_by_curve(scene, 1), len(write_svg(scene, precision=1))
    assert len(sizes) == scene.curves
    assert sum(sizes) == pytest.approx(whole, rel=0.3)
    assert read_svg(write_svg(scene, precision=1)).curves == scene.curves


def test_curves_whose_bytes_count_share_an_opacity_that_is_said_once(noisy):
    result = vectorize(noisy, max_bytes=2500, **SHORT)
    assert result.svg.count("fill-opacity") == 1
    assert len(np.unique(result.scene.opacities)) == 1
    assert 0.5 < float(result.scene.opacities[0]) < 1.0
    assert np.array_equal(read_svg(result.svg).opacities, result.scene.opacities)


@pytest.mark.parametrize("others", [{"background": "none"}, {"opaque": True}, {"fill": "linear"}])
def test_they_share_none_where_that_would_change_what_is_asked_for(noisy, others):
    result = vectorize(noisy, max_bytes=4000, **SHORT | others)
    assert len(result.svg.encode()) <= 4000
    opacities = result.scene.opacities
    assert bool((opacities == 1).all()) if "opaque" in others else len(np.unique(opacities)) > 1


def test_an_interrupted_fit_keeps_to_the_budget(noisy):
    """A Ctrl-C in the first fit leaves as many of its curves as fit."""
    result = vectorize(noisy, max_bytes=4000, on_progress=ctrl_c, **SHORT | {"steps": 4000})
    assert result.report.interrupted
    assert len(result.svg.encode()) <= 4000
