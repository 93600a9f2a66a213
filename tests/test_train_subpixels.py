"""The training of the network that tells where in their pixels fills lie, in small."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from cubicsplat_cli.raster import unmix

ROOT = Path(__file__).parents[1]


@pytest.fixture
def train_subpixels(monkeypatch: pytest.MonkeyPatch):
    """The module of the tool."""
    monkeypatch.syspath_prepend(ROOT / "tools")
    import train_subpixels

    yield train_subpixels
    del sys.modules["train_subpixels"]


def test_examples_show_pixels_of_both_fills_in_one_orientation(train_subpixels) -> None:
    rng = np.random.default_rng(3)
    around, own = (
        np.concatenate(each) for each in zip(*(train_subpixels.Scene(rng).examples() for _ in range(6)), strict=True)
    )
    middle, offsets = around[:, 4, 4], np.arange(9) - 4.0
    assert len(around) > 300 and around.shape[1:] == (9, 9) and own.shape[1:] == (4, 4)
    assert middle.min() > 0 and middle.max() <= 127
    right, down = (around.astype(float).sum(axis=axis) @ offsets for axis in (1, 2))
    assert (right >= down).all() and (down >= 0.0).all()
    # The steps are the pixel's own, of which some show samples: one of these is 16 levels.
    assert np.median(np.abs(own.mean(axis=(1, 2)) - middle)) < 16.0


def test_the_network_is_trained_and_read(train_subpixels, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    for name, value in {
        "SCENES": 4,
        "ROUNDS": 2,
        "BATCH": 64,
        "HIDDEN": 8,
        "SUBPIXELS": tmp_path / "weights.npz",
    }.items():
        monkeypatch.setattr(train_subpixels, name, value)
    train_subpixels.main()
    with np.load(tmp_path / "weights.npz") as stored:
        shapes = [stored[name].shape for name in stored.files]
    assert shapes == [(8, 81), (8,), (8, 8), (8,), (16, 8), (16,)]


def test_shapes_are_told_better_than_by_the_shares_between_pixels(train_subpixels) -> None:
    rng = np.random.default_rng(9)  # of no scene that the network was trained with
    errors = []
    for _ in range(8):
        inside = train_subpixels.Scene(rng).inside.astype(np.float32)
        steps = inside.reshape(256, 4, 256, 4).mean(axis=(1, 3))
        share = steps.reshape(64, 4, 64, 4).mean(axis=(1, 3))
        first, second = (share == 1.0).astype(np.int32), (share > 0.0).astype(np.int32)
        levels = unmix.finer_labels(first, second, share, np.array([[0.0] * 4, [255.0] * 4]), 4)[1][..., 0] / 255.0
        mixed = np.repeat(np.repeat(first != second, 4, axis=0), 4, axis=1)
        even = np.repeat(np.repeat(share, 4, axis=0), 4, axis=1)
        errors.append([((values - steps)[mixed] ** 2).sum() for values in (levels, even)])
    told, by_shares = np.sum(errors, axis=0)
    assert told < 0.3 * by_shares
