"""Letters and thin lines, traced in several steps a pixel."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import rest_slow
from PIL import Image, ImageDraw, ImageFont

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.regions.regions import FlatPicture, pixel_fills
from cubicsplat_cli.artwork.traced import MOST_STEPS, STEPS, in_steps, steps_of
from cubicsplat_cli.progress import Work, under_way
from cubicsplat_cli.raster.unmix import blend_pairs, finer_labels

PAPER, INK, PALE = (255.0, 255.0, 255.0, 255.0), (20.0, 30.0, 40.0, 255.0), (137.5, 142.5, 147.5, 255.0)


def page(paper: int, ink: int, size: int = 11, times: int = 1) -> np.ndarray:
    """(34, 150, 3) uint8 two lines of small text, size px high, drawn so many times as large and reduced."""
    image = Image.new("L", (times * 150, times * 34), paper)
    pen, font = ImageDraw.Draw(image), ImageFont.load_default(times * size)
    pen.text((times * 4, times * 3), "the quick brown fox", ink, font=font)
    pen.text((times * 5, times * 18), "jumps over seven dogs", ink, font=font)
    small = image.resize((150, 34), Image.Resampling.LANCZOS)
    return np.repeat(np.asarray(small)[..., None], 3, axis=2)


@pytest.mark.parametrize(("paper", "ink"), rest_slow((30, 220), (255, 20)))
def test_small_text_stays_text(paper: int, ink: int) -> None:
    """Traced by pixels, its counters close and its thin strokes break: 28 dB."""
    made = vectorize(page(paper, ink), style="artwork", threads=1)
    assert made.report.quality.svg.psnr_db > 33.0


def test_text_is_traced_finer_for_what_its_outlines_will_cost() -> None:
    """Not for all their pieces, of which merges leave three of four: 32 dB as fragments."""
    made = vectorize(page(255, 60, size=5, times=8), style="artwork", threads=1)
    assert made.report.quality.svg.psnr_db > 40.0


def field(share: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The labels and levels in steps of a picture of ink on paper, of which the ink has shares (H, W)."""
    first = np.zeros(share.shape, np.int32)
    second = ((share > 0.0) & (share < 1.0)).astype(np.int32)
    first[share == 1.0] = second[share == 1.0] = 1
    return finer_labels(first, second, share.astype(np.float32), np.array([PAPER, INK]), STEPS)


def in_pixels(values: np.ndarray) -> np.ndarray:
    """The mean over each pixel of values (H steps, W steps)."""
    return values.reshape(values.shape[0] // STEPS, STEPS, -1, STEPS).mean(axis=(1, 3))


def line_shares(angle: float, wide: float) -> np.ndarray:
    """(24, 24) the shares of a line through the middle."""
    y, x = (np.mgrid[0 : 24 * 16, 0 : 24 * 16] + 0.5) / 16.0 - 12.0
    off = np.abs(np.cos(angle) * y - np.sin(angle) * x) < 0.5 * wide
    return off.reshape(24, 16, 24, 16).mean(axis=(1, 3))


@pytest.mark.parametrize("angle", [0.3, 0.7, 1.2])
@pytest.mark.parametrize("wide", [0.75, 0.9, 1.7])
def test_a_line_under_a_pixel_wide_stays_one_line(angle: float, wide: float) -> None:
    share = line_shares(angle, wide)
    labels, levels = field(share)
    assert np.sqrt(np.mean((in_pixels(labels) - share) ** 2)) < 0.06
    rows = [np.flatnonzero(row) for row in (labels if abs(np.sin(angle)) > 0.7 else labels.T)[8:-8]]
    assert all(len(row) and row[-1] - row[0] == len(row) - 1 for row in rows)
    assert levels.min() >= min(INK) - 1e-3 and levels.max() <= max(PAPER) + 1e-3


def test_what_is_one_fill_stays_it() -> None:
    share = np.zeros((6, 8))
    share[2:4, 3:6] = 1.0
    assert (field(share)[0] == np.repeat(np.repeat(share, STEPS, axis=0), STEPS, axis=1)).all()


def test_the_field_turns_with_its_picture() -> None:
    share = line_shares(0.4, 0.8)
    assert (field(share[::-1])[0] == field(share)[0][::-1]).all()
    assert (field(share.T)[0] == field(share)[0].T).all()


def test_threads_do_not_matter() -> None:
    share = np.tile(line_shares(0.4, 0.8), (4, 4))
    found = []
    for threads in (1, 3):
        with under_way(Work(threads=threads)):
            found.append(field(share)[1])
    assert (found[0] == found[1]).all()


def test_a_letter_is_of_one_ink_though_a_paler_one_would_explain_some_of_it() -> None:
    palette = np.array([PAPER, INK, PALE])
    share = np.array([0.1, 0.5, 0.5, 0.9, 0.2])
    values = ((1.0 - share)[:, None] * palette[0] + share[:, None] * palette[1]).astype(np.float32)
    near = np.full((5, 4), -1)
    near[:, 0] = 0
    near[1, 1] = 2
    first, second, found = blend_pairs(values, np.zeros(5, int), palette, near, 3.0)
    inks = np.where(first == 0, second, first)
    assert (inks == 1).all() and np.allclose(np.where(first == 0, found, 1.0 - found), share, atol=0.01)
    # A darker fill that explains a letter as well, but is not near, is none of it.
    grounds = np.array([[217.0] * 3 + [255.0], [17.0] * 3 + [255.0], [62.0] * 3 + [255.0]])
    letter = grounds[0] + np.linspace(0.2, 0.9, 6)[:, None] * (grounds[2] - grounds[0])
    near = np.array([[0, 2, -1, -1]] * 6)
    assert set(np.concatenate(blend_pairs(letter, np.zeros(6, int), grounds, near, 3.0)[:2]).tolist()) == {0, 2}
    # Alone, the value that the pale ink is near to is taken for its.
    alone = blend_pairs(values[1:2], np.zeros(1, int), palette[[0, 2]], near[1:2, [0, 0, 0, 0]], 3.0)
    assert alone[0].tolist() == [0] and alone[1].tolist() == [1] and alone[2][0] == pytest.approx(1.0)


def test_a_pale_letter_has_the_palest_ink_that_explains_it() -> None:
    palette = np.array([PAPER, [0.0, 0.0, 0.0, 255.0], [120.0, 120.0, 120.0, 255.0], [190.0, 190.0, 190.0, 255.0]])
    share = np.linspace(0.2, 1.0, 9)[:, None]
    values = palette[0] + share * (palette[3] - palette[0])
    near = np.tile([0, -1, -1, -1], (9, 1))
    first, second, found = blend_pairs(values, np.zeros(9, int), palette, near, 3.0)
    assert (first == 0).all() and (second == 3).all()
    assert np.allclose(found, share[:, 0], atol=0.01)


def test_what_falls_to_pieces_is_not_traced_finer() -> None:
    noise = np.random.default_rng(0).choice([20.0, 255.0], (20, 20))
    soft = (noise + np.roll(noise, 1, 0) + np.roll(noise, 1, 1)) / 3.0
    levels = np.dstack([soft] * 3 + [np.full_like(soft, 255.0)]).astype(np.float32)
    fills = pixel_fills(FlatPicture(levels, np.array([PAPER, (20.0, 20.0, 20.0, 255.0)])))
    assert in_steps(levels, fills, STEPS, 1.0, 1) is None
    assert in_steps(levels, fills, STEPS, 1.0, 10_000).labels.shape == (20 * STEPS, 20 * STEPS)


def test_specks_below_half_a_pixel_are_no_pieces() -> None:
    share = np.zeros((20, 20))
    share[8:12, 8:12], share[1::5, 1::4] = 1.0, 0.25
    levels = (np.array(PAPER) + share[..., None] * np.subtract(INK, PAPER)).astype(np.float32)
    fills = pixel_fills(FlatPicture(levels, np.array([PAPER, INK])))
    assert in_steps(levels, fills, STEPS, 1.0, 2) is not None
    assert in_steps(levels, fills, STEPS, 1.0, 1) is None


@pytest.mark.slow
def test_what_has_more_regions_than_are_drawn_is_not_traced_finer(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cubicsplat_cli.artwork.traced.MOST_REGIONS", 30)
    made = vectorize(page(255, 20), style="artwork", threads=1)
    assert made.report.quality.svg.psnr_db < 31.0


def test_large_pictures_have_fewer_steps() -> None:
    sides = [(300, 400), (1000, 1000), (1500, 1500), (2000, 3000)]
    assert [steps_of(*each) for each in sides] == [4, 3, 2, 1]
    assert all(height * width * steps_of(height, width) ** 2 <= MOST_STEPS for height, width in sides)
