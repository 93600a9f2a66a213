"""Pictures whose ground was removed by its colour, and those with colours of a ground at edges of the right opacity."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import ndimage
from test_artwork_input import SIDE, pixels

from cubicsplat_cli.api import vectorize
from cubicsplat_cli.artwork.input.matte import without_matte
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.files.load import as_picture

GROUNDS = {"white": 255.0, "black": 0.0}


def drawn() -> np.ndarray:
    """(H, W, 4) uint8 straight RGBA of a face on nothing."""
    return pixels("clean")


def over(picture: np.ndarray, level: float) -> np.ndarray:
    """The colours of a picture over a ground of a level."""
    share = picture[..., 3:] / 255.0
    return np.rint(share * picture[..., :3] + (1.0 - share) * level).astype(np.uint8)


def cut_out(tolerance: int = 24) -> np.ndarray:
    """The face over white, which was made clear where it is near enough to white and reaches the rim."""
    colours = over(drawn(), 255.0)
    parts, _ = ndimage.label(np.abs(colours.astype(int) - 255).max(axis=2) <= tolerance)
    clear = (parts == parts[0, 0]) & (parts > 0)
    return np.dstack([colours, np.where(clear, 0, 255).astype(np.uint8)])


def levels_of(picture: np.ndarray) -> np.ndarray:
    return np.rint(as_levels(as_picture(picture).target()))


def off(picture: np.ndarray) -> float:
    """Root mean square of the levels by which a picture is off the face on nothing, over edges."""
    truth = levels_of(drawn())
    edge = (truth[..., 3] > 0.0) & (truth[..., 3] < 255.0)
    return float(np.sqrt(np.square(picture - truth)[edge].mean()))


def test_hard_pale_edges_of_a_cut_out_become_opacity():
    given = levels_of(cut_out())
    found, ground = without_matte(given)
    assert ground == "white" and off(given) > 60.0 and off(found) < 12.0


@pytest.mark.parametrize("ground", GROUNDS)
def test_soft_edges_lose_the_colour_of_their_ground(ground):
    given = levels_of(np.dstack([over(drawn(), GROUNDS[ground]), drawn()[..., 3]]))
    found, name = without_matte(given)
    assert name == ground and off(found) < 0.2 * off(given)


def test_edges_of_the_right_colour_stay():
    hard = np.dstack([drawn()[..., :3], np.where(drawn()[..., 3] > 127, 255, 0).astype(np.uint8)])
    for picture in (drawn(), hard, hard[..., :3], np.zeros((9, 9, 4), np.uint8)):
        given = levels_of(picture)
        assert without_matte(given)[0] is given


def test_a_pale_outline_of_one_px_is_no_remains():
    """As sprites have: its colour is a blend of the fill and white, but always the same one."""
    y, x = np.mgrid[:SIDE, :SIDE]
    far = np.hypot(y - 80, x - 80)
    fill = np.where(far[..., None] < 60.0, [190, 25, 49], [222, 140, 152])
    given = levels_of(np.dstack([fill, np.where(far < 61.0, 255, 0)]).astype(np.uint8))
    assert without_matte(given)[0] is given


def test_an_outline_in_the_colour_of_a_ground_is_no_remains():
    """A black plate with a white outline of 1.5 px, as signs have: pure white would have been removed."""
    far = np.hypot(*(axis - 80.3 for axis in np.mgrid[:SIDE, :SIDE]))
    white, black = (np.clip(radius - far, 0.0, 1.0) for radius in (61.5, 60.0))
    grey = 255.0 * (1.0 - black)
    given = levels_of(np.rint(np.dstack([grey, grey, grey, 255.0 * white])).astype(np.uint8))
    assert without_matte(given)[0] is given


def test_fills_near_to_the_ground_tell_nothing_about_it():
    """A disc that is nearly white but for a red stripe: most of its rim could show no remains."""
    y, x = np.mgrid[:SIDE, :SIDE]
    share = np.clip(60.5 - np.hypot(y - 80.3, x - 80.3), 0.0, 1.0)[..., None]
    fill = np.where((np.abs(y - 80) < 40)[..., None], [190, 25, 49], [250, 240, 240])
    colours = np.rint(share * fill + (1.0 - share) * 255.0)
    given = levels_of(np.dstack([colours, np.where(share > 0.0, 255, 0)]).astype(np.uint8))
    found, ground = without_matte(given)
    before, after = (np.abs(each[..., 3] - 255.0 * share[..., 0]).mean() for each in (given, found))
    assert ground == "white" and after < 0.2 * before


def test_a_cut_out_is_drawn_as_what_was_cut_out():
    done = vectorize(cut_out(), measure=False)
    assert done.report.shapes == vectorize(drawn(), measure=False).report.shapes
    assert "made without the remains of a white ground at its edges" in done.report.notes
