"""What a person sees in a noisy picture is drawn: pale areas in their own colour, and lines of a px in one piece."""

from __future__ import annotations

import numpy as np
import pytest
from image_files import recoded
from scipy import ndimage

from benchmarks.artwork.document import Document
from cubicsplat_cli.artwork.input.condition import condition_of
from cubicsplat_cli.artwork.input.prepare import as_levels
from cubicsplat_cli.artwork.input.restore import restored
from cubicsplat_cli.artwork.regions.hairlines import with_lines
from cubicsplat_cli.artwork.regions.regions import FlatPicture, Regions, find_regions
from cubicsplat_cli.files.load import as_picture

SIDE = 200
SKIN, GROUND, HAIR, RED = (253, 224, 208), (237, 227, 226), (14, 27, 71), (190, 25, 49)


def hexed(colour: tuple[int, ...]) -> str:
    return "#{:02x}{:02x}{:02x}".format(*colour)


def flat_picture(body: str, quality: int = 75, ground: tuple[int, ...] = GROUND) -> FlatPicture:
    """A drawing after a JPEG, restored."""
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {SIDE} {SIDE}">'
        f'<path d="M0 0H{SIDE}V{SIDE}H0z" fill="{hexed(ground)}"/>{body}</svg>'
    )
    jpeg = recoded(Document(text.encode(), "x", SIDE).draw()[..., :3], quality=quality, subsampling=2)
    levels = as_levels(as_picture(jpeg).target())
    assert condition_of(levels).jpeg
    return restored(levels, condition_of(levels))


def regions_of(picture: FlatPicture) -> Regions:
    return find_regions(picture)


HAIRY = f'<path d="M30 96A66 66 0 0 1 170 96L150 120A50 50 0 0 0 50 120z" fill="{hexed(HAIR)}"/>'
FACE = f'<circle cx="100" cy="110" r="55" fill="{hexed(SKIN)}"/>{HAIRY}'


@pytest.mark.parametrize("quality", [60, 80])
def test_light_skin_on_a_light_grey_ground_keeps_its_colour(quality):
    picture = flat_picture(FACE, quality)
    assert len(picture.palette) == 3
    for place, colour in (((130, 100), SKIN), ((10, 10), GROUND), ((60, 100), HAIR)):
        assert np.abs(picture.levels[place][:3] - colour).max() <= 3.0


@pytest.mark.parametrize("width", [6, 12])
def test_a_colour_between_two_that_only_borders_both_is_none(width):
    rings = (f'<circle cx="100" cy="100" r="{10 + 22.5 * k}" stroke-width="{width}"/>' for k in range(4))
    body = f'<g fill="none" stroke="#236bff">{"".join(rings)}</g>'
    assert len(flat_picture(body, 95, (255, 255, 255)).palette) == 2


def test_what_a_jpeg_leaves_beside_edges_is_no_colour():
    bars = "".join(
        f'<path d="M{x} 20H{x + 18}V180H{x}z" fill="{fill}"/>'
        for x, fill in ((20, "#be1931"), (38, "#1d4ed8"), (80, "#be1931"), (110, "#1d4ed8"), (150, "#15803d"))
    )
    assert len(flat_picture(bars, 60, (255, 255, 255)).palette) == 4


def test_a_thin_smile_on_a_face_is_one_line():
    smile = f'<path d="M72 126Q100 152 130 124" stroke="{hexed(HAIR)}" stroke-width="1.2" fill="none"/>'
    regions = regions_of(flat_picture(FACE + smile))
    window = np.abs(regions.fills[regions.labels[121:150, 68:134], :3] - HAIR).max(axis=-1) < 16.0
    parts, _ = ndimage.label(window)
    assert max(np.ptp(np.nonzero(parts == k)[1]) for k in range(1, parts.max() + 1)) >= 54


def test_the_thin_borders_of_a_map_hang_together():
    lands = "".join(
        f'<path d="{d}" fill="{fill}"/>'
        for d, fill in (("M0 0H97L60 200H0z", "#c8e6c9"), ("M97 0H200V90L78 100z", "#ffe0b2"))
    )
    borders = '<path d="M97 0L60 200M78 100L200 90M138 95L150 200" stroke="#333" stroke-width="1" fill="none"/>'
    regions = regions_of(flat_picture(lands + borders, 75, (187, 222, 251)))
    dark = regions.fills[:, :3].max(axis=1) < 110.0
    sizes = np.sort(regions.areas[dark])[::-1]
    assert sizes[0] >= 0.9 * sizes.sum() and sizes.sum() >= 400


def test_a_line_of_two_px_has_its_own_colour():
    line = '<path d="M60 20L84 180" stroke="#1b6088" stroke-width="2.6" fill="none"/>'
    parts = f'<path d="M0 0H{SIDE}V40H0z" fill="#60362a"/><path d="M0 160H{SIDE}V{SIDE}H0z" fill="#fff"/>'
    picture = flat_picture(parts + line, 76, (66, 137, 193))
    assert np.abs(picture.palette[:, :3] - (27, 96, 136)).max(axis=1).min() <= 12.0


def test_a_gap_in_a_line_is_closed_where_its_share_is_less_than_half():
    palette = np.array([[255.0, 255.0, 255.0, 255.0], [0.0, 0.0, 0.0, 255.0]])
    share = np.zeros((40, 60))
    share[20, 5:55] = 0.7
    # Between two rows for a while, neither of which has most of it.
    share[20, 24:30], share[21, 24:30] = 0.40, 0.34
    levels = palette[0] + share[..., None] * (palette[1] - palette[0])
    labels = (share >= 0.5).astype(np.int32)
    lined = with_lines(levels, palette, labels, 24.0, 0.3)
    assert (lined[20, 5:55] == 1).all() and lined.sum() == 50
    # Where all is explained nothing changes: an edge has a pixel of any share.
    edge = np.zeros((40, 60, 4)) + palette[0]
    edge[:20], edge[20] = palette[1], 0.6 * palette[0] + 0.4 * palette[1]
    labels = np.zeros((40, 60), np.int32)
    labels[:20] = 1
    assert (with_lines(edge, palette, labels, 24.0, 0.3) == labels).all()


def test_beads_of_six_px_with_black_outlines_have_their_own_colours():
    fills = [(222, 32, 16), (33, 121, 0)]
    beads = "".join(
        f'<circle cx="{16 + 14 * k}" cy="{60 + 40 * row}" r="4" stroke="#000" stroke-width="2" fill="{hexed(fill)}"/>'
        for row, fill in enumerate(fills)
        for k in range(13)
    )
    disc = '<circle cx="100" cy="160" r="20" fill="#ffd200"/>'
    palette = flat_picture(beads + disc, 80, (255, 255, 255)).palette[:, :3]
    for fill in (*fills, (0, 0, 0), (255, 210, 0)):
        assert np.abs(palette - fill).max(axis=1).min() <= 20.0, fill
    assert len(palette) <= 6
