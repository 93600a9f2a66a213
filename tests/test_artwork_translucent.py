"""Translucent shapes over several grounds: one shape with its paint and opacity, and the grounds whole beneath it."""

from __future__ import annotations

import numpy as np
import pytest
import test_artwork_draw
from conftest import rest_slow
from image_files import recoded
from test_artwork_draw import box, disc

from cubicsplat_cli.artwork.geometry.outlines import Circle, Rectangle
from cubicsplat_cli.artwork.layers.merging import FULL, Overlay, laid_over, likeliest, paint_of, with_covered
from cubicsplat_cli.artwork.layers.translucent import goes_on, meetings, without_overlays
from cubicsplat_cli.artwork.regions.regions import Regions
from cubicsplat_cli.artwork.regions.sampling import edge_positions
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.artwork.shapes import Drawing
from cubicsplat_cli.artwork.vectorize import draw
from cubicsplat_cli.raster.outlines import EdgePositions
from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing

SIZE, FINE = 120, 8
PAPER = (248, 244, 233, 255)


def painted(*layers, ground=PAPER) -> np.ndarray:
    """(SIZE, SIZE, 4) premultiplied: layers are functions of x, y (px) and a fill of 8 bits, back to front."""
    premultiplied = [(inside, levels(fill) / FULL) for inside, fill in layers]
    return test_artwork_draw.painted(SIZE, SIZE, *premultiplied, ground=levels(ground) / FULL, fine=FINE)


def levels(fill) -> np.ndarray:
    return np.array([*(v * fill[3] / FULL for v in fill[:3]), fill[3]])


def slanted(x, y):
    """A band that slants, and goes beyond the canvas."""
    return np.abs(x - 45.0 - 0.3 * y) < 18.0


RED, BLUE, GREEN = (230, 57, 70, 255), (29, 112, 184, 255), (42, 157, 143, 255)
YELLOW = (249, 200, 14, 153)
SHADE, SHEEN = (0, 0, 0, 51), (255, 255, 255, 102)
FLAG = ((box(0, 0, 120, 40), RED), (box(0, 80, 120, 120), BLUE))


def translucent(drawing: Drawing) -> list[int]:
    """Which shapes are."""
    return [k for k, shape in enumerate(drawing.shapes) if shape.fill[3] < 255]


def test_two_discs_that_overlap_are_two_circles():
    drawing = draw(painted((disc(45, 60, 30), (*RED[:3], 153)), (disc(75.5, 60, 30), (*BLUE[:3], 128))))
    ground, lower, upper = drawing.shapes
    assert ground.fill == PAPER and isinstance(ground.outlines[0], Rectangle)
    # Of the lower one only one ground is seen, so that it may as well be opaque.
    assert lower.fill[3] == 255 and upper.fill == pytest.approx((*BLUE[:3], 128), abs=2)
    for shape, x in ((lower, 45.0), (upper, 75.5)):
        (circle,) = shape.outlines
        assert isinstance(circle, Circle)
        assert (circle.cx, circle.cy, circle.r) == pytest.approx((x, 60.0, 30.0), abs=0.03)


@pytest.mark.slow
def test_the_uppermost_of_three_discs_is_the_one_that_was_drawn_last():
    discs = [
        (disc(47, 50, 26), (*RED[:3], 153)),
        (disc(73, 50, 26), (*BLUE[:3], 153)),
        (disc(60, 72, 26), (249, 200, 14, 153)),
    ]
    for order in ((0, 1, 2), (2, 0, 1)):
        drawing = draw(painted(*(discs[k] for k in order)))
        assert len(drawing.shapes) == 4 and translucent(drawing) == [2, 3]
        for shape, k in zip(drawing.shapes[2:], order[1:], strict=True):
            assert shape.fill == pytest.approx(discs[k][1], abs=2)


@pytest.mark.parametrize("film", rest_slow((SHADE,), (SHEEN,)))
def test_stripes_go_on_beneath_a_film(film):
    drawing = draw(painted(*FLAG, (slanted, film)))
    assert len(drawing.shapes) == 4 and translucent(drawing) == [3]
    assert drawing.shapes[3].fill == film
    assert {shape.fill for shape in drawing.shapes[:3]} == {PAPER, RED, BLUE}
    assert all(isinstance(shape.outlines[0], Rectangle) for shape in drawing.shapes[:3])
    assert drawing.shapes[3].outlines[0].ring().pieces == 4


def test_what_lies_on_a_film_stays_above_it():
    drawing = draw(painted(*FLAG, (box(20, 20, 100, 100), SHEEN), (disc(60, 60, 12), GREEN)))
    fills = [shape.fill for shape in drawing.shapes]
    assert len(fills) == 5 and fills.index(SHEEN) == 3 and fills[4] == GREEN
    film = drawing.shapes[3].outlines
    assert len(film) == 1 and isinstance(film[0], Rectangle)


def test_a_film_over_nothing_and_over_a_shape():
    drawing = draw(painted((box(20, 20, 70, 70), RED), (disc(70, 70, 30), (*BLUE[:3], 153)), ground=(0, 0, 0, 0)))
    lower, upper = drawing.shapes
    assert lower.fill == RED and isinstance(lower.outlines[0], Rectangle)
    assert upper.fill == pytest.approx((*BLUE[:3], 153), abs=2) and isinstance(upper.outlines[0], Circle)


@pytest.mark.slow
def test_what_only_several_films_make_of_the_ground_is_theirs():
    # The piece beneath the uppermost one in which the two others overlap is seen nowhere else.
    films = [(disc(38.5, 60, 26), (*RED[:3], 153)), (disc(81.5, 60, 26), (*BLUE[:3], 153)), (disc(60, 60, 25), YELLOW)]
    drawing = draw(painted((lambda x, y: y > 50.0 + 0.3 * x, GREEN), *films))
    assert len(drawing.shapes) == 5 and translucent(drawing) == [2, 3, 4]
    circles = [shape.outlines[0] for shape in drawing.shapes[2:]]
    assert all(isinstance(circle, Circle) for circle in circles)
    assert [circle.cx for circle in circles] == pytest.approx([38.5, 81.5, 60.0], abs=0.05)


def test_four_opaque_fills_that_meet_stay_opaque():
    quarters = (box(0, 0, 60, 60), RED), (box(60, 0, 120, 60), BLUE), (box(0, 60, 60, 120), GREEN)
    assert translucent(draw(painted(*quarters))) == []
    # The dark squares of a check are not the light ones beneath a shade.
    check = (box(0, 0, 60, 60), (0, 0, 0, 255)), (box(60, 60, 120, 120), (40, 40, 40, 255))
    assert translucent(draw(painted(*check))) == []


def shown(names) -> tuple[Regions, EdgePositions]:
    """Regions 0 to 3 where names (h, w) of x, y say so, from the middle: of grounds 0 and 1, shaded 2 and 3."""
    y, x = (np.mgrid[: SIZE * FINE, : SIZE * FINE] + 0.5) / FINE - SIZE / 2
    shares = (names(x, y)[..., None] == np.arange(4)).reshape(SIZE, FINE, SIZE, FINE, 4).mean(axis=(1, 3))
    fills = np.array([levels(PAPER), levels(RED), 0.8 * levels(PAPER), 0.8 * levels(RED)])
    fills[:, 3] = FULL
    regions = Regions(shares.argmax(axis=2), np.rint(fills), np.arange(4))
    return regions, edge_positions(shares @ regions.fills, regions)


def test_both_edges_must_go_straight_on():
    straight = shown(lambda x, y: (y > 0.3 * x) + 2 * (x > 0.2 * y))
    assert len(without_overlays(*straight, np.zeros(straight[0].count, bool))[1]) == 1
    # The grounds' edge turns where it crosses the film's.
    bent = shown(lambda x, y: (y > np.where(x > 0.2 * y, 0.6 * x, 0.0)) + 2 * (x > 0.2 * y))
    assert without_overlays(*bent, np.zeros(bent[0].count, bool))[1] == ()
    # The film's edge turns where it crosses the grounds'.
    broken = shown(lambda x, y: (y > 0.0) + 2 * (x > np.where(y > 0.0, 0.5 * y, 0.0)))
    assert without_overlays(*broken, np.zeros(broken[0].count, bool))[1] == ()


def test_a_meeting_is_found_once_and_its_edges_go_on():
    regions, found = shown(lambda x, y: (y > 0.3 * x) + 2 * (x > 0.2 * y))
    ((at, _),) = meetings(regions.labels)
    assert at == pytest.approx((60.0, 60.0), abs=1.5)
    assert goes_on(regions.labels, found, at, (0, 1), (2, 3)) is True
    assert goes_on(regions.labels, found, at, (0, 2), (1, 3)) is True
    assert goes_on(regions.labels, found, at, (0, 1), (1, 3)) is False


def test_a_paint_follows_from_two_grounds():
    grounds = np.array([levels(PAPER), levels(RED), levels(BLUE)])
    fill = (200, 180, 20, 90)
    seen = np.rint(levels(fill) + (1.0 - 90 / FULL) * grounds)
    found = paint_of(seen, grounds)
    assert found is not None and found == pytest.approx(fill, abs=2)
    assert laid_over(found, grounds) == pytest.approx(seen, abs=1.5)
    # Four levels off in one channel of one is another paint.
    off = seen.copy()
    off[1, 1] += 4.0
    assert paint_of(off, grounds) is None
    # Grounds that are alike say nothing, nor does what hides them.
    assert paint_of(seen[:2] * 0.0 + seen[0], np.array([grounds[0], grounds[0] - 3.0])) is None
    assert paint_of(np.array([seen[0], seen[0]]), grounds[:2]) is None


@pytest.mark.parametrize("fill", [(255, 255, 255, 51), (0, 0, 0, 38), (30, 60, 90, 204)])
def test_the_likeliest_fill_is_what_a_program_was_given(fill):
    grounds = np.array([levels(v) for v in (PAPER, RED, BLUE, GREEN)])
    over, through = np.rint(levels(fill)), grounds * (FULL - fill[3])
    for left in (np.rint(through / FULL), np.floor((through + FULL) / 256.0)):
        assert likeliest(over + left, grounds) == pytest.approx(fill, abs=1)


def test_who_chooses_fills_or_has_shapes_cut_out_gets_opaque_ones():
    picture = painted(*FLAG, (slanted, SHADE))
    fill = (0, 0, 0), (255, 255, 255)
    for settings in (ArtworkSettings(colors=6), ArtworkSettings(stacking="cutout"), ArtworkSettings(palette=fill)):
        assert translucent(draw(picture, settings)) == []


def ringed(films, fill) -> tuple[Regions, np.ndarray, list[Overlay]]:
    """A square of a fill on paper, and small overlays of these fills beside it that do not touch each other."""
    labels = np.zeros((40, 40), dtype=np.int32)
    labels[10:30, 10:30] = 1
    overlays = []
    for k, film in enumerate(films):
        cover = np.zeros(labels.shape, dtype=bool)
        cover[8:10, 10 + 4 * k : 12 + 4 * k] = True
        overlays.append(Overlay(film, cover))
    return Regions(labels, np.array([levels(PAPER), fill]), np.arange(2)), np.zeros(2, dtype=bool), overlays


def test_what_films_make_of_a_neighbour_is_theirs_in_the_order_that_does():
    films = [(*RED[:3], 153), (*BLUE[:3], 153)]
    for above, below in ((0, 1), (1, 0)):
        fill = levels(PAPER)
        for k in (below, above):
            fill = laid_over(films[k], fill[None])[0]
        regions, fixed, overlays = with_covered(*ringed(films, fill))
        assert regions.count == 1 and fixed.tolist() == [False]
        assert [overlay.paint for overlay in overlays] == [films[above], films[below]]
        assert all(overlay.cover[10:30, 10:30].all() for overlay in overlays)


def test_many_films_over_each_other_do_not_make_an_opaque_shape():
    # Five of them would make nearly the fill itself, of whatever ground.
    fill = (220, 48, 17, 166)
    regions, fixed, overlays = ringed([fill] * 5, levels((*fill[:3], 255)))
    made = levels(PAPER)
    for overlay in overlays:
        made = laid_over(overlay.paint, made[None])[0]
    assert np.abs(made - regions.fills[1]).max() < 1.5
    after, _, same = with_covered(regions, fixed, overlays)
    assert after.count == 2 and not any(overlay.cover[10:30, 10:30].any() for overlay in same)


@pytest.mark.slow
def test_a_film_counts_as_a_shape():
    picture = painted(*FLAG, (slanted, SHADE))
    assert len(draw(picture, ArtworkSettings(curves=4)).shapes) == 4
    assert len(draw(picture, ArtworkSettings(curves=3)).shapes) <= 3


def test_the_file_says_the_opacity_and_is_read_again():
    drawing = draw(painted(*FLAG, (slanted, SHADE)))
    text = write_drawing(drawing, title="film", comment="test")
    assert text.count("fill-opacity") == 1 and 'fill-opacity=".2"' in text.replace("0.2", ".2")
    assert [shape.fill for shape in read_drawing(text).shapes] == [shape.fill for shape in drawing.shapes]


def test_a_jpeg_has_no_films():
    jpeg = recoded(painted(*FLAG, (slanted, SHADE))[..., :3] * FULL, quality=80)
    assert translucent(draw(jpeg.astype(np.float32) / np.float32(FULL))) == []
