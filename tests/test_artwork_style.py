import numpy as np
import pytest

from cubicsplat_cli.artwork.style import choose_style, flatness
from cubicsplat_cli.files.load import load_picture


@pytest.mark.parametrize(
    ("name", "style"),
    [("chelsea.png", "photo"), ("astronaut.jpg", "photo"), ("logo.png", "artwork"), ("landscape.png", "artwork")],
)
def test_the_samples_get_their_styles(name, style):
    assert choose_style(load_picture(f"samples/{name}").rgb)[0] == style


def test_noise_is_a_photo_and_an_even_picture_artwork():
    rng = np.random.default_rng(0)
    style, reason = choose_style(rng.random((64, 64, 3)).astype(np.float32))
    assert style == "photo" and reason == "only 0% of the picture is flat"
    assert choose_style(np.full((1, 1, 3), 0.5, np.float32))[0] == "artwork"


def test_what_is_clear_does_not_count():
    picture = np.zeros((64, 64, 4), np.float32)
    assert choose_style(picture)[0] == "artwork"
    picture[:20, :20] = np.random.default_rng(1).random((20, 20, 1)).astype(np.float32)
    assert choose_style(picture)[0] == "photo"


def test_flatness_counts_flat_pixels_and_their_inks():
    picture = np.zeros((30, 40, 3), np.float32)
    picture[:, 20:] = 1.0
    flat, few = flatness(picture)
    assert flat == pytest.approx(38 / 40) and few == 1.0
