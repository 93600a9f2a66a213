"""Loading pictures: every format and colour mode gives the right values, upright, in sRGB."""

from __future__ import annotations

import hashlib
import struct

import numpy as np
import pytest
from image_files import NOISE, encode, png_chunk, png_of, swapped_profile
from PIL import Image, ImageCms

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.load import Picture, as_picture, enlarge_picture, load_picture, resize_picture


def test_rgb_png_is_exact(tmp_path):
    data = encode(Image.fromarray(NOISE))
    path = tmp_path / "noise.png"
    path.write_bytes(data)
    picture = load_picture(path)
    assert (picture.width, picture.height) == (17, 13)
    assert picture.rgb.dtype == np.float32
    assert np.array_equal(picture.rgb, NOISE.astype(np.float32) / 255)
    assert picture.alpha is None
    assert picture.sha256 == hashlib.sha256(data).hexdigest()
    assert picture.source == str(path)
    assert picture.notes == ()
    assert picture.target() is picture.rgb


@pytest.mark.parametrize("file_format", ["PNG", "BMP", "TIFF", "PPM", "WEBP"])
def test_lossless_formats_agree_whatever_the_extension(tmp_path, file_format):
    options = {"lossless": True} if file_format == "WEBP" else {}
    path = tmp_path / "wrong.jpg"
    path.write_bytes(encode(Image.fromarray(NOISE), file_format, **options))
    assert np.array_equal(load_picture(path).rgb, NOISE.astype(np.float32) / 255)


@pytest.mark.parametrize(("file_format", "tolerance"), [("JPEG", 0.03), ("GIF", 0.02)])
def test_lossy_formats_are_close(file_format, tolerance):
    ramp = np.linspace(0, 255, 64).astype(np.uint8)
    image = Image.fromarray(np.repeat(ramp[None, :], 16, axis=0))
    picture = load_picture(encode(image, file_format))
    assert np.abs(picture.rgb - (ramp.astype(np.float32) / 255)[None, :, None]).max() < tolerance


def test_bytes_have_a_name():
    data = encode(Image.fromarray(NOISE))
    assert load_picture(data).source == "<bytes>"
    assert load_picture(data, name="<stdin>").source == "<stdin>"


@pytest.mark.parametrize("size", [(1, 1), (1, 9), (9, 1)])
def test_tiny_pictures(size):
    picture = load_picture(encode(Image.new("RGB", size, (51, 102, 204))))
    assert picture.rgb.shape == (size[1], size[0], 3)
    assert np.allclose(picture.rgb, [0.2, 0.4, 0.8])


def test_one_bit():
    image = Image.new("1", (4, 2))
    image.putpixel((2, 1), 1)
    expected = np.zeros((2, 4, 3), np.float32)
    expected[1, 2] = 1
    assert np.array_equal(load_picture(encode(image)).rgb, expected)


def test_grey_and_grey_with_alpha():
    picture = load_picture(encode(Image.new("L", (3, 2), 51)))
    assert np.allclose(picture.rgb, 0.2)
    assert picture.alpha is None
    image = Image.new("LA", (3, 2), (51, 255))
    image.putpixel((1, 0), (200, 0))
    picture = load_picture(encode(image))
    assert np.allclose(picture.rgb[0, 0], 0.2)
    assert np.array_equal(picture.rgb[0, 1], [0, 0, 0]), "the colour of a fully transparent pixel is dropped"
    assert np.array_equal(picture.alpha, [[1, 0, 1], [1, 1, 1]])


def test_rgba_is_straight_and_premultiplied_on_request():
    image = Image.new("RGBA", (2, 1), (255, 102, 0, 51))
    image.putpixel((1, 0), (9, 9, 9, 0))
    picture = load_picture(encode(image))
    assert np.allclose(picture.rgb, [[[1, 0.4, 0], [0, 0, 0]]])
    assert np.allclose(picture.alpha, [[0.2, 0]])
    assert np.allclose(picture.target(), [[[0.2, 0.08, 0, 0.2], [0, 0, 0, 0]]])
    assert picture.target().dtype == np.float32


def test_opaque_alpha_counts_as_none():
    picture = load_picture(encode(Image.new("RGBA", (2, 2), (1, 2, 3, 255))))
    assert picture.alpha is None
    assert picture.target().shape == (2, 2, 3)
    assert np.array_equal(picture.premultiplied()[..., 3], np.ones((2, 2)))


def test_entirely_transparent_is_noted():
    picture = load_picture(encode(Image.new("RGBA", (2, 2), (1, 2, 3, 0))))
    assert not picture.alpha.any()
    assert any("transparent" in note for note in picture.notes)


def test_palette_with_transparency():
    image = Image.new("P", (3, 1))
    image.putpalette([255, 0, 0, 0, 255, 0, 0, 0, 255])
    image.putdata([0, 1, 2])
    picture = load_picture(encode(image))
    assert np.array_equal(picture.rgb, [[[1, 0, 0], [0, 1, 0], [0, 0, 1]]])
    assert picture.alpha is None
    picture = load_picture(encode(image, transparency=bytes([255, 0, 51])))
    assert np.allclose(picture.alpha, [[1, 0, 0.2]])
    assert np.array_equal(picture.rgb, [[[1, 0, 0], [0, 0, 0], [0, 0, 1]]])


def test_rgb_colour_key():
    image = Image.new("RGB", (2, 1), (10, 20, 30))
    image.putpixel((1, 0), (0, 255, 0))
    picture = load_picture(encode(image, transparency=(10, 20, 30)))
    assert np.array_equal(picture.alpha, [[0, 1]])


def test_sixteen_bit_grey_keeps_its_precision():
    values = np.array([[0, 1, 257], [40000, 65534, 65535]], np.uint16)
    picture = load_picture(encode(Image.fromarray(values)))
    assert np.allclose(picture.rgb[..., 0], values / 65535, atol=1e-7)
    assert picture.rgb[0, 1, 0] > 0, "one step of 16 bits must survive"
    assert np.array_equal(picture.rgb[..., 0], picture.rgb[..., 2])


@pytest.mark.parametrize("byte_order", ["<u2", ">u2"])
def test_sixteen_bit_tiff_of_either_byte_order(byte_order):
    values = np.array([[0, 1, 257], [40000, 65534, 65535]], byte_order)
    data = encode(Image.fromarray(values), "TIFF")
    assert np.allclose(load_picture(data).rgb[..., 1], values.astype(float) / 65535, atol=1e-7)


def test_sixteen_bit_grey_key_value():
    rows = b"".join(b"\0" + struct.pack(">HH", *row) for row in [(1000, 1001), (65535, 1000)])
    data = png_of(2, 2, 16, 0, rows, png_chunk(b"tRNS", struct.pack(">H", 1000)))
    picture = load_picture(data)
    assert np.array_equal(picture.alpha, [[0, 1], [1, 0]])
    assert np.allclose(picture.rgb[..., 0], [[0, 1001 / 65535], [1, 0]])


def test_sixteen_bit_colour_is_read_with_eight_and_says_so():
    rows = b"\0" + struct.pack(">6H", 0x3333, 0x6666, 0xCCCC, 0xFFFF, 0, 0x8080)
    picture = load_picture(png_of(2, 1, 16, 2, rows))
    assert np.allclose(picture.rgb, [[[0.2, 0.4, 0.8], [1, 0, 128 / 255]]])
    assert any("16 bits" in note for note in picture.notes)


@pytest.mark.parametrize("depth", [np.uint8, np.uint16])
def test_tiff_in_which_white_is_zero(depth):
    values = (np.arange(12).reshape(3, 4) * 5).astype(depth)
    full = np.iinfo(depth).max
    data = encode(Image.fromarray(values), "TIFF")
    # The tag 262 (photometric interpretation), one short: 1 where black is zero.
    tag = struct.pack("<HHIHH", 262, 3, 1, 1, 0)
    assert data.count(tag) == 1
    picture = load_picture(data.replace(tag, struct.pack("<HHIHH", 262, 3, 1, 0, 0)))
    expected = (full - values.astype(np.float32)) / full
    np.testing.assert_allclose(picture.rgb, np.repeat(expected[..., None], 3, axis=2), atol=1e-6)


def test_float_tiff():
    values = np.array([[0.0, 0.25], [0.5, 1.0]], np.float32)
    picture = load_picture(encode(Image.fromarray(values), "TIFF"))
    assert np.array_equal(picture.rgb[..., 0], values)


@pytest.mark.parametrize(("value", "word"), [(255.0, "255"), (-3.0, "-3"), (np.nan, "undefined"), (np.inf, "infinite")])
def test_float_outside_the_range_is_refused(value, word):
    values = np.array([[0.0, value]], np.float32)
    with pytest.raises(InputError, match=word):
        load_picture(encode(Image.fromarray(values), "TIFF"))
    with pytest.raises(InputError, match=word):
        as_picture(values.astype(float))


def test_an_array_without_pixels_is_refused():
    with pytest.raises(InputError, match="no pixel"):
        as_picture(np.zeros((0, 4, 3), np.uint8))


def test_integers_beyond_16_bits_are_refused():
    with pytest.raises(InputError, match="70000"):
        load_picture(encode(Image.fromarray(np.array([[0, 70000]], np.int32)), "TIFF"))


def test_cmyk():
    image = Image.new("CMYK", (2, 1), (0, 0, 0, 0))
    image.putpixel((1, 0), (0, 255, 255, 0))
    picture = load_picture(encode(image, "TIFF"))
    assert np.array_equal(picture.rgb, [[[1, 1, 1], [1, 0, 0]]])
    assert any("CMYK" in note for note in picture.notes)


@pytest.mark.parametrize("file_format", ["PNG", "TIFF", "WEBP", "JPEG"])
@pytest.mark.parametrize("orientation", range(1, 9))
def test_exif_orientation(file_format, orientation):
    # Corners: top left red, top right green, bottom left blue, bottom right white, in the stored picture.
    stored = np.zeros((16, 32, 3), np.uint8)
    stored[:8, :16, 0] = stored[:8, 16:, 1] = stored[8:, :16, 2] = 255
    stored[8:, 16:] = 255
    # EXIF 2.32, tag 0x0112: where the stored first row and first column belong in the upright picture.
    upright = {
        1: stored,
        2: stored[:, ::-1],
        3: stored[::-1, ::-1],
        4: stored[::-1],
        5: stored.transpose(1, 0, 2),
        6: np.rot90(stored, -1),
        7: stored[::-1, ::-1].transpose(1, 0, 2),
        8: np.rot90(stored, 1),
    }[orientation]
    exif = Image.Exif()
    exif[0x0112] = orientation
    options = {"lossless": True} if file_format == "WEBP" else {"quality": 95, "subsampling": 0}
    picture = load_picture(encode(Image.fromarray(stored), file_format, exif=exif, **options))
    assert picture.rgb.shape == upright.shape
    assert np.abs(picture.rgb - upright / 255).mean() < 0.02


def test_broken_exif_is_noted_and_the_picture_read():
    data = encode(Image.fromarray(NOISE), exif=b"Exif\0\0XX*\0\x08\0\0\0\xff\xff")
    picture = load_picture(data)
    assert np.array_equal(picture.rgb, NOISE.astype(np.float32) / 255)
    assert any("EXIF" in note for note in picture.notes)


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_profile_of_deep_grey_is_ignored_and_noted(dtype):
    values = np.array([[0, 1]], dtype)
    picture = load_picture(encode(Image.fromarray(values), "TIFF", icc_profile=swapped_profile()))
    assert picture.rgb.shape == (1, 2, 3)
    assert any("profile ignored" in note for note in picture.notes)


def test_lab_is_converted():
    picture = load_picture(encode(Image.new("LAB", (2, 2), (255, 128, 128)), "TIFF"))
    assert np.allclose(picture.rgb, 1, atol=0.01)


def test_a_mode_that_pillow_cannot_convert_is_refused(monkeypatch):
    data = encode(Image.fromarray(NOISE))

    def convert(self, mode):
        raise ValueError("conversion not supported")

    monkeypatch.setattr(Image.Image, "convert", convert)
    with pytest.raises(InputError, match="colour mode RGB is not supported; save it as RGB"):
        load_picture(data)


def test_warnings_of_the_decoder_become_notes(recwarn):
    data = encode(Image.fromarray(NOISE), exif=b"Exif\0\0II*\0\x08\0\0\0\xff\xff")
    assert any("Corrupt EXIF" in note for note in load_picture(data).notes)
    # Files that other tests have left open may be closed, with a warning, while this one runs.
    assert not [warning for warning in recwarn if issubclass(warning.category, UserWarning)]


@pytest.mark.parametrize("file_format", ["GIF", "PNG", "WEBP", "TIFF"])
def test_animated_first_frame_with_a_note(file_format):
    red, blue = Image.new("RGB", (8, 6), (255, 0, 0)), Image.new("RGB", (8, 6), (0, 0, 255))
    options = {"lossless": True} if file_format == "WEBP" else {}
    picture = load_picture(encode(red, file_format, save_all=True, append_images=[blue], **options))
    assert np.allclose(picture.rgb, [1, 0, 0])
    assert any("first" in note for note in picture.notes)


@pytest.mark.parametrize("mode", ["RGB", "RGBA", "P"])
def test_embedded_profile_is_applied(mode):
    image = Image.new("RGBA", (4, 4), (255, 0, 0, 255))
    image.putpixel((0, 0), (0, 0, 0, 0))
    picture = load_picture(encode(image.convert(mode), icc_profile=swapped_profile()))
    assert np.allclose(picture.rgb[2, 2], [0, 0, 1], atol=0.02)
    assert picture.notes == ()
    if mode == "RGBA":
        assert picture.alpha[0, 0] == 0
        assert picture.alpha[2, 2] == 1


@pytest.mark.parametrize(
    ("kind", "said"),
    [("sRGB", None), ("LAB", "does not fit"), (None, "profile")],  # None: no profile at all
)
def test_a_profile_that_changes_nothing_or_cannot_be_used(kind, said):
    profile = b"not a profile at all"
    if kind is not None:
        profile = ImageCms.ImageCmsProfile(ImageCms.createProfile(kind)).tobytes()
    picture = load_picture(encode(Image.fromarray(NOISE), icc_profile=profile))
    assert np.array_equal(picture.rgb, NOISE.astype(np.float32) / 255)
    assert [said in note for note in picture.notes] == [True] * (said is not None)


def flat_picture(rgb: np.ndarray, alpha: np.ndarray | None = None) -> Picture:
    return Picture(rgb.astype(np.float32), None if alpha is None else alpha.astype(np.float32), "made", "0" * 64)


def test_resize_returns_the_same_object_when_it_fits():
    picture = flat_picture(np.full((4, 6, 3), 0.5))
    assert resize_picture(picture, 6) is picture


@pytest.mark.parametrize(("shape", "max_size", "wanted"), [((40, 60), 30, (20, 30)), ((500, 1), 10, (10, 1))])
def test_resize_keeps_the_aspect_and_a_constant_colour(shape, max_size, wanted):
    picture = flat_picture(np.broadcast_to(np.array([0.2, 0.5, 0.9]), (*shape, 3)))
    scaled = resize_picture(picture, max_size)
    assert (scaled.height, scaled.width) == wanted
    assert np.allclose(scaled.rgb, [0.2, 0.5, 0.9], atol=1e-6)
    assert scaled.alpha is None
    assert f"{shape[1]} x {shape[0]}" in scaled.notes[-1]
    assert scaled.sha256 == picture.sha256


def test_resize_does_not_let_hidden_colours_bleed_in():
    rgb = np.zeros((32, 32, 3))
    rgb[:, :16] = [1, 0, 0]
    alpha = np.zeros((32, 32))
    alpha[:, :16] = 1
    scaled = resize_picture(flat_picture(rgb, alpha), 11)
    edge = (scaled.alpha > 0.05) & (scaled.alpha < 0.95)
    assert edge.any(), "the edge must lie inside a pixel for this test to mean anything"
    assert np.allclose(scaled.rgb[edge], [1, 0, 0], atol=1e-3)
    assert (scaled.rgb[scaled.alpha == 0] == 0).all()
    assert scaled.target().shape == (11, 11, 4)
    assert scaled.rgb.dtype == scaled.alpha.dtype == np.float32


def test_resize_stays_in_range_although_lanczos_overshoots():
    rgb = np.zeros((33, 33, 3))
    rgb[::2] = 1
    scaled = resize_picture(flat_picture(rgb), 20)
    assert scaled.rgb.min() >= 0
    assert scaled.rgb.max() <= 1


@pytest.mark.parametrize("factor", [2, 3, 4])
@pytest.mark.parametrize("transparent", [False, True])
def test_an_enlarged_picture_has_the_pixels_as_its_means(factor, transparent):
    y, x = np.mgrid[0:12, 0:20]
    rgb = np.stack([0.5 + 0.3 * np.sin(x / 2), 0.5 + 0.3 * np.cos(y / 3), np.full((12, 20), 0.25)], -1)
    alpha = 0.5 + 0.4 * np.cos((x + y) / 4) if transparent else None
    picture = flat_picture(rgb, alpha)
    enlarged = enlarge_picture(picture, factor)
    assert enlarged.size == (20 * factor, 12 * factor)
    means = enlarged.target().reshape(12, factor, 20, factor, -1).mean(axis=(1, 3))
    assert np.abs(means - picture.target()).max() < 0.01
    assert np.allclose(enlarged.rgb[..., 2], 0.25, atol=0.01)


def test_an_enlarged_picture_stays_in_range_and_hides_what_is_transparent():
    alpha = np.zeros((8, 8))
    alpha[2:5, 2:5] = 1
    enlarged = enlarge_picture(flat_picture(np.random.default_rng(2).random((8, 8, 3)), alpha), 4)
    assert enlarged.rgb.min() >= 0
    assert enlarged.rgb.max() <= 1
    assert (enlarged.alpha.min(), enlarged.alpha.max()) == (0, 1)
    assert (enlarged.rgb[enlarged.alpha == 0] == 0).all()
