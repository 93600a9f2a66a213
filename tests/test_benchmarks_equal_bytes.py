"""`benchmarks.equal_bytes`: SVGs beside raster formats of as many bytes."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from PIL import Image

from benchmarks.equal_bytes import Encoder, formats
from cubicsplat_cli import compare


@pytest.fixture(scope="module")
def waves() -> Image.Image:
    y, x = np.mgrid[:48, :64]
    picture = np.stack([128 + 90 * np.sin(x / 9), 128 + 90 * np.cos(y / 7), 2.0 * x + y], axis=-1)
    return Image.fromarray(np.clip(picture, 0, 255).astype(np.uint8))


def test_the_best_file_is_as_small_as_it_must_be_and_no_worse_than_a_plain_one(waves):
    buffer = io.BytesIO()
    waves.save(buffer, "JPEG", quality=30, optimize=True)
    plain = compare(np.asarray(waves), np.asarray(Image.open(buffer))).psnr_db
    encoder = Encoder(waves, "JPEG")
    level, size = encoder.best(buffer.tell())
    assert size <= buffer.tell()
    assert level >= plain - 0.01
    assert encoder.best(100) is None, "its tables alone are larger"


def test_each_picture_has_a_row_for_each_format_and_size(waves, tmp_path, run_benchmark):
    waves.save(tmp_path / "waves.png")
    done = run_benchmark("equal_bytes", tmp_path, "--bytes", "200,300", "--side", 24, "--json")
    rows = json.loads(done.stdout)["rows"]
    assert [(row["format"], row["most"]) for row in rows] == [
        (form, most) for most in (200, 300) for form in ("cubicsplat", *formats())
    ]
    assert all(row["bytes"] is None or row["bytes"] <= row["most"] for row in rows)
    ours = [row["psnr_db"] for row in rows if row["format"] == "cubicsplat"]
    assert ours[1] > ours[0] > 20.0
