"""`--weights` and `--focus`: what matters gets the curves, by the real command, the library and the fit."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from cli_runs import save_pictures, strict_json
from PIL import Image

from cubicsplat_cli import vectorize
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.images import of_pixels
from cubicsplat_cli.evaluate.metrics import compare, weighted_psnr_db
from cubicsplat_cli.files.load import as_picture, resize_picture
from cubicsplat_cli.files.weights import load_mask, pixel_weights
from cubicsplat_cli.options import parse_focus
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import fit
from cubicsplat_cli.photo.seeding import spread_of
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings

SHORT = {"curves": 10, "steps": 120, "threads": 1, "preset": "draft"}
OPTIONS = ("--curves", 10, "--steps", 120, "--threads", 1, "--preset", "draft")
LEFT = np.zeros((28, 40), np.uint8)
LEFT[:, :20] = 255


@pytest.fixture
def noisy() -> np.ndarray:
    """More detail than the curves can show, everywhere alike."""
    small = np.random.default_rng(5).integers(0, 256, (7, 10, 3), np.uint8)
    return small.repeat(4, 0).repeat(4, 1)


def left_psnr(result, picture: np.ndarray) -> float:
    return compare(as_picture(picture[:, :20]), of_pixels(result.pixels[:, :20, :3].copy())).psnr_db


def test_what_a_mask_ignores_gives_its_curves_to_the_rest(noisy):
    even, left = vectorize(noisy, style="photo", **SHORT), vectorize(noisy, weights=LEFT, **SHORT)
    assert left_psnr(left, noisy) > left_psnr(even, noisy) + 0.5
    quality = left.report.quality
    assert quality.weighted_psnr_db == pytest.approx(left_psnr(left, noisy), abs=1e-3)
    assert quality.svg.psnr_db < even.report.quality.svg.psnr_db, "the usual figures stay unweighted"
    assert even.report.quality.weighted_psnr_db is None
    assert (left.report.style, left.report.style_reason) == ("photo", "asked for by weights")


def test_the_real_command_takes_a_mask_and_a_focus(noisy_file, tmp_path, run_cli):
    mask = tmp_path / "mask.png"
    Image.fromarray(LEFT).save(mask)
    arguments = ("vectorize", noisy_file, *OPTIONS, "--weights", mask, "--focus", "0,0,10,28,3")
    done = run_cli(*arguments, "--json", "-q")
    found = strict_json(done.stdout)
    assert found["settings"]["weights"]["name"] == str(mask)
    assert found["settings"]["focus"] == [0, 0, 10, 28, 3]
    assert found["quality"]["weighted_psnr_db"] > found["quality"]["svg"]["psnr_db"]
    assert strict_json(run_cli(*arguments, "--json", "-q").stdout)["status"] == "unchanged"
    Image.fromarray(255 - LEFT).save(mask)
    assert strict_json(run_cli(*arguments, "--json", "-q").stdout)["status"] == "done", "another mask, another result"


def test_a_folder_takes_one_mask(noisy, tmp_path, run_cli):
    mask, folder = tmp_path / "mask.png", tmp_path / "pictures"
    folder.mkdir()
    Image.fromarray(LEFT).save(mask)
    for name in ("a.png", "b.png"):
        Image.fromarray(noisy).save(folder / name)
    run_cli("vectorize", folder, *OPTIONS, "--weights", mask, "--no-png", "-q", "-j", 2)
    reports = [strict_json((folder / name).read_bytes()) for name in ("a.json", "b.json")]
    assert len({report["quality"]["weighted_psnr_db"] for report in reports}) == 1


@pytest.mark.parametrize(
    ("options", "code", "text"),
    [
        (("--focus", "1,2,3"), 2, "--focus must be X,Y,W,H or X,Y,W,H,FACTOR"),
        (("--focus", "1,2,3,a"), 2, "--focus must be X,Y,W,H"),
        (("--focus", "0,0,0,9"), 2, "--focus must be X,Y,W,H"),
        (("--focus", "0,0,9,9,nan"), 2, "--focus must be X,Y,W,H"),
        (("--focus", "40,0,9,9"), 1, "the focus lies outside of its 40 x 28 pixels; give a rectangle within"),
        (("--focus", "0,0,9,9", "--style", "artwork"), 2, "--focus is for photos"),
        (("--weights", "none.png"), 1, "none.png"),
        (("--weights", "black.png"), 1, "the mask is all black; paint white what matters"),
        (("--weights", "wide.png"), 1, "which the mask wide.png with 80 x 28 does not fit"),
    ],
)
def test_what_cannot_be_is_said_in_one_line(noisy_file, run_cli, monkeypatch, options, code, text):
    monkeypatch.chdir(noisy_file.parent)
    Image.new("L", (40, 28)).save("black.png")
    Image.new("L", (80, 28), 255).save("wide.png")
    run_cli("vectorize", noisy_file, "-q", *OPTIONS, *options, code=code, error=text)
    assert not noisy_file.with_suffix(".svg").exists()


def test_masks_and_focus_are_scaled_to_the_picture(noisy):
    picture, mask = as_picture(noisy), load_mask(LEFT.repeat(2, 0).repeat(2, 1))
    assert pixel_weights(picture, None, None, (40, 28)) is None
    weights = pixel_weights(picture, mask, None, (40, 28))
    assert weights.shape == (28, 40)
    assert weights.mean() == pytest.approx(1.0)
    assert (weights[:, :19] > 1.9).all() and (weights[:, 21:] < 0.1).all()
    small = resize_picture(picture, 20)
    focused = pixel_weights(small, None, parse_focus("0,0,19,28,9"), (40, 28))
    ratios = focused[3] / focused[3, -1]
    assert ratios[0] == pytest.approx(9.0)
    assert ratios[9] == pytest.approx(5.0), "half of the pixel lies inside"
    clear = np.dstack([np.full((28, 40, 3), 255, np.uint8), LEFT])
    assert np.array_equal(load_mask(clear).grey > 0, LEFT > 0), "what is transparent counts nothing"


def test_a_folder_of_masks_has_one_for_each_picture_and_a_later_run_knows_them(tmp_path, run_cli):
    save_pictures(tmp_path / "in", ["a.png", "b.png", "sub/a.png", "plain.png"])
    masks = tmp_path / "masks"
    (masks / "sub").mkdir(parents=True)
    shapes = {name: Image.open(tmp_path / "in" / name).size for name in ("a.png", "b.png", "sub/a.png")}
    for name, place in (("a.png", "a.webp"), ("b.png", "b.png"), ("b.png", "b.webp"), ("sub/a.png", "sub/a.png")):
        Image.new("L", shapes[name], 255).save(masks / place, lossless=True)
    run = ["vectorize", tmp_path / "in", "-r", "-o", tmp_path / "out", "--weights", masks, *OPTIONS, "--json"]
    done = run_cli(*run)
    found = {line["output"]["svg"].split("/out/")[1]: line for line in map(strict_json, done.stdout.splitlines())}
    used = {
        name: line["settings"]["weights"] and Path(line["settings"]["weights"]["name"]) for name, line in found.items()
    }
    assert used == {
        "a.svg": masks / "a.webp", "b.svg": masks / "b.png", "sub/a.svg": masks / "sub" / "a.png", "plain.svg": None,
    }  # fmt: skip
    assert done.stderr.count(b"has no mask in") == 1
    assert b"plain.png: has no mask in" in done.stderr
    left = Image.new("L", shapes["b.png"])
    left.paste(255, (0, 0, 9, 9))
    left.save(masks / "b.png")
    again = [strict_json(line) for line in run_cli(*run).stdout.splitlines()]
    assert sorted(line["status"] for line in again) == ["done", "unchanged", "unchanged", "unchanged"]
    assert {Path(line["output"]["svg"]).name for line in again if line["status"] == "done"} == {"b.svg"}


@pytest.mark.parametrize(
    ("names", "code", "said"),
    [
        ([], 2, "--weights has no picture of the name of"),
        (["b.png", "b.jpg", "a.gif", "a.bmp"], 2, "--weights has two masks for"),
        (["a.png"], 1, "does not fit"),
    ],
)
def test_masks_that_are_of_no_use_are_one_line(names, code, said, tmp_path, run_cli):
    save_pictures(tmp_path, ["a.png"])
    (tmp_path / "masks").mkdir()
    for name in names:
        Image.new("L", (80, 9), 255).save(tmp_path / "masks" / name)
    given = (tmp_path / "a.png", "--weights", tmp_path / "masks", *OPTIONS, "-q")
    run_cli("vectorize", *given, code=code, error=said)


def test_artwork_takes_no_mask():
    with pytest.raises(UsageError, match="for photos"):
        Request(style="artwork", masks=Path())
    with pytest.raises(UsageError, match="for photos"):
        Request(style="artwork", weights=load_mask(LEFT))


def test_the_fit_refuses_weights_that_are_none():
    target = np.zeros((4, 6, 3), np.float32)
    for weights in (np.zeros((4, 6)), np.ones((6, 4)), np.full((4, 6), -1.0), np.full((4, 6), np.inf)):
        with pytest.raises(InputError, match="weights must be"):
            fit(target, FitSettings(curves=1, steps=1), inputs=FitInputs(weights.astype(np.float32)))


def test_the_weighted_figure_is_the_mean_of_the_weighted_squares(noisy):
    other = np.clip(noisy.astype(int) + 10, 0, 255).astype(np.uint8)
    weights = np.random.default_rng(1).random((28, 40)).astype(np.float32)
    squares = np.square((noisy / 255.0) - (other / 255.0)).mean(2)
    want = -10 * math.log10((squares * weights).sum() / weights.sum())
    assert weighted_psnr_db(as_picture(noisy), of_pixels(other), weights) == pytest.approx(want, abs=1e-4)
    assert weighted_psnr_db(as_picture(noisy), of_pixels(noisy), weights) is None


def test_curves_spread_over_the_share_that_counts():
    assert spread_of(None) == 1.0
    assert spread_of(torch.from_numpy(LEFT[:, :40] / 1.0)) == pytest.approx(0.5)
