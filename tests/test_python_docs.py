"""The examples of docs/python.md run, one after the other, as a reader would type them."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from conftest import smooth_pixels
from PIL import Image

import cubicsplat_cli

ROOT = Path(__file__).resolve().parents[1]
TEXT = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)


def test_the_examples_run_and_print_nothing_of_their_own(tmp_path, monkeypatch, capfd):
    Image.fromarray(smooth_pixels(64, 48)).save(tmp_path / "photo.png")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    assert len(EXAMPLES) >= 7
    for example in EXAMPLES:
        exec(compile(example, "docs/python.md", "exec"), names)
    out, err = capfd.readouterr()
    assert err == ""
    assert len(out.splitlines()) == sum(example.count("print(") for example in EXAMPLES)
    assert cubicsplat_cli.read_svg((tmp_path / "large.svg").read_text()).width == 128


def test_the_example_of_a_loss_is_short():
    (example,) = [example for example in EXAMPLES if "ms_ssim" in example]
    assert len([line for line in example.splitlines() if line.strip()]) < 30


def test_every_public_name_is_typed_and_documented():
    for name in cubicsplat_cli.__all__:
        assert getattr(cubicsplat_cli, name).__doc__ or name == "__version__", name
    assert (Path(cubicsplat_cli.__file__).parent / "py.typed").is_file()


@pytest.mark.parametrize(
    "picture",
    [
        smooth_pixels(24, 20),
        smooth_pixels(24, 20, alpha=True),
        smooth_pixels(24, 20)[..., 0],
        smooth_pixels(24, 20) / 255.0,
        Image.fromarray(smooth_pixels(24, 20)),
        Image.fromarray(smooth_pixels(24, 20)).convert("P"),
    ],
)
def test_pictures_of_every_kind_are_taken(picture):
    result = cubicsplat_cli.vectorize(picture, style="photo", curves=6, steps=10, threads=1)
    assert (result.report.input.width, result.report.input.height) == (24, 20)
    assert cubicsplat_cli.compare(picture, result).psnr_db == pytest.approx(result.report.quality.svg.psnr_db, abs=1e-6)


@pytest.mark.parametrize(
    "wrong",
    [3, smooth_pixels(8, 8).astype(int), smooth_pixels(8, 8) * 1.0, smooth_pixels(8, 8)[:, :, :2], b"no picture"],
)
def test_what_is_no_picture_is_refused(wrong):
    with pytest.raises(cubicsplat_cli.InputError):
        cubicsplat_cli.vectorize(wrong)
