"""Inputs for fuzzing: sound files of every kind, and what can be done to them. The same number gives the same bytes."""

from __future__ import annotations

import io
import random
import re
import struct
import zlib
from collections.abc import Callable
from functools import cache

import numpy as np
import torch
from PIL import Image

from cubicsplat_cli.artwork.geometry.outlines import Circle, Ellipse, Rectangle, polygon, ring_of_cubics
from cubicsplat_cli.artwork.shapes import Drawing, Shape
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.drawing_writer import write_drawing
from cubicsplat_cli.svg.scene_writer import write_svg

_EDGES = (0, 1, 2, 0x7F, 0x80, 0xFF)
_WORDS = (0, 1, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0xFFFF, 0x10000)
_NUMBER = re.compile(rb"-?\d*\.?\d+")
_NUMBERS = (b"0", b"-0", b"1e9", b"1e-400", b"9" * 30, b".", b"-", b"", b"NaN", b"4000001", b"1.5", b"0x7", b"--1")
_XML = (
    b"<path/>", b"<g>", b"</g>", b"<svg>", b"</svg>", b"<!-- x -->", b"<!DOCTYPE svg>", b"<![CDATA[x]]>", b"&amp;",
    b"&#0;", b"&x;", b"<?xml-stylesheet href='a'?>", b'<!ENTITY a "b">', b' d="M0 0"', b' id="x"', b"\xff\xfe",
    b' transform="scale(.1)"', b' transform="scale(.0000000001)"', b"M0 0C1 1 2 2 3 3z", b"c1 1 2 2-3-3", b"z", b"\0",
    b'<image href="a.png"/>', b"<use href='#a'/>", b"<style>@import 'x'</style>", b"url(http://x)", b"<a>" * 300,
)  # fmt: skip


def make_input(target: str, number: int, seed: int) -> bytes:
    """The bytes of one input: a sound file, damaged in one to eight ways, or of artwork a sound picture of any kind."""
    rng = random.Random(f"{seed}:{target}:{number}")
    if target == "artwork":
        return artwork_input(np.random.default_rng([seed, number]))
    seeds = picture_seeds() if target == "picture" else drawing_seeds()
    data = bytearray(rng.choice(seeds))
    ways = PICTURE_WAYS if target == "picture" else DRAWING_WAYS
    for _ in range(rng.choice((1, 1, 1, 2, 2, 3, 5, 8))):
        data = rng.choice(ways)(data, rng)
        if not data:
            break
    if target == "picture" and data.startswith(b"\x89PNG") and rng.random() < 0.7:
        data = _with_sums(data)
    return bytes(data)


@cache
def picture_seeds() -> tuple[bytes, ...]:
    """Small pictures in every format and colour mode that is read."""
    noise = np.random.default_rng(7).integers(0, 256, (13, 17, 4), dtype=np.uint8)
    colour, clear = Image.fromarray(noise[..., :3]), Image.fromarray(noise)
    exif = Image.Exif()
    exif[0x0112] = 6
    frames = {"save_all": True, "append_images": [colour.transpose(Image.Transpose.ROTATE_180)]}
    saved: list[tuple[Image.Image, str, dict]] = [
        (clear, "PNG", {}),
        (colour.quantize(16), "PNG", {"transparency": 3}),
        (colour.convert("1"), "PNG", {}),
        (colour.convert("L"), "PNG", {"exif": exif}),
        (Image.fromarray(noise[..., 0].astype(np.uint16) * 257), "PNG", {}),
        (colour, "JPEG", {"exif": exif}),
        (colour, "JPEG", {"progressive": True}),
        (colour.convert("CMYK"), "JPEG", {}),
        (colour, "WEBP", {"lossless": True}),
        (clear, "WEBP", {"quality": 30}),
        (colour, "WEBP", frames),
        (colour, "BMP", {}),
        (colour.quantize(16), "BMP", {}),
        (colour, "TIFF", {}),
        (colour, "TIFF", {"compression": "tiff_lzw"}),
        (clear, "TIFF", {"compression": "tiff_deflate"}),
        (colour.convert("1"), "TIFF", {"compression": "group4"}),
        (Image.fromarray(noise[..., 0].astype(np.float32) / 255), "TIFF", {}),
        (colour.quantize(16), "GIF", {}),
        (colour.quantize(8), "GIF", {"save_all": True, "append_images": [colour.quantize(8)]}),
        (colour, "PPM", {}),
        (colour.convert("L"), "PPM", {}),
        (colour.convert("1"), "PPM", {}),
    ]
    return (*(_saved(image, kind, options) for image, kind, options in saved), b"P3 2 1 255 1 2 3 4 5 6\n")


def artwork_input(rng: np.random.Generator) -> bytes:
    """A small PNG of flat shapes with hard or soft edges, thin lines, noise, checkers, or nothing, clear or not."""
    width, height = (int(side) for side in rng.choice((1, 2, 3, 5, 8, 16, 24, 40), 2))
    fills = rng.integers(0, 256, (8, 4)).astype(np.float32)
    fills[:, 3] = np.where(rng.random(8) < 0.7, 255.0, fills[:, 3] * (rng.random(8) < 0.7))
    zoom = int(rng.choice((1, 1, 4)))  # soft edges come of a larger drawing
    pixels = np.empty((height * zoom, width * zoom, 4), np.float32)
    pixels[:] = fills[0]
    y, x = np.mgrid[: height * zoom, : width * zoom].astype(np.float32)
    for fill in fills[1 : rng.integers(1, 8)]:
        pixels[_shape(rng, x, y)] = fill
    pixels = pixels.reshape(height, zoom, width, zoom, 4).mean(axis=(1, 3))
    if rng.random() < 0.2:
        pixels += rng.normal(0.0, rng.choice((1.0, 8.0, 80.0)), pixels.shape)
    return _saved(Image.fromarray(np.clip(np.rint(pixels), 0, 255).astype(np.uint8)), "PNG", {})


def _shape(rng: np.random.Generator, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """(H, W) bool: an ellipse, a half-plane, a box, a thin line, a checkerboard, or scattered pixels."""
    (cx, cy), (rx, ry) = rng.random(2) * x.shape[::-1], 0.5 + rng.random(2) * x.shape[::-1] / 2
    angle = rng.random() * 2 * np.pi
    across = (x - cx) * np.cos(angle) + (y - cy) * np.sin(angle)
    forms = (
        ((x - cx) / rx) ** 2 + ((y - cy) / ry) ** 2 < 1,
        across > 0,
        (np.abs(x - cx) < rx) & (np.abs(y - cy) < ry),
        np.abs(across) < rng.choice((0.5, 1.0, 2.0)),
        (x // max(1, int(rx)) + y // max(1, int(ry))) % 2 == 0,
        rng.random(x.shape) < 0.1,
    )
    return forms[rng.integers(len(forms))]


def _saved(image: Image.Image, kind: str, options: dict) -> bytes:
    buffer = io.BytesIO()
    image.save(buffer, kind, **options)
    return buffer.getvalue()


@cache
def drawing_seeds() -> tuple[bytes, ...]:
    """SVG files of ours of every form, and some that are not ours."""
    rng = np.random.default_rng(3)
    found = []
    for mode in Mode:
        for precision in (0, 2, 6):
            for background in (None, (0.2, 0.4, 1.0)):
                shape = (3, 6 + (mode is Mode.OPEN), 2)
                scene = Scene(
                    mode=mode, width=24, height=20, background=background,
                    points=torch.tensor(rng.normal(10, 8, shape), dtype=torch.float32),
                    colours=torch.tensor(rng.random((3, 3)), dtype=torch.float32),
                    opacities=torch.tensor([0.5, 1.0, 0.123]),
                    half_widths=torch.full((3,), 0.7 if mode is Mode.OPEN else 0.0),
                )  # fmt: skip
                found.append(write_svg(scene, precision=precision, title="a & b", comment="cubicsplat").encode())
    ring = ring_of_cubics(rng.normal(10, 6, (4, 4, 2)))
    outlines = (ring, polygon(rng.normal(10, 6, (5, 2))), Circle(9, 8, 5), Ellipse(9, 8, 5, 3, 0.4))
    shapes = [Shape((9, 99, 200, 255), outlines, "all"), Shape((1, 2, 3, 99), (Rectangle(1, 2, 9, 8, 2, 0.3),), "r")]
    shapes += [Shape((255, 0, 0, 255), (outline,), "one") for outline in outlines]
    found += [
        write_drawing(Drawing(24, 20, tuple(shapes)), precision=p, title="a", comment="c").encode() for p in (0, 2, 6)
    ]
    foreign = b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 9 9"><g><rect width="1e1" height="5%"/></g></svg>'
    return (*found, foreign, b"\xef\xbb\xbf" + foreign, foreign.decode().encode("utf-16"))


def _flip(data: bytearray, rng: random.Random) -> bytearray:
    data[rng.randrange(len(data))] ^= 1 << rng.randrange(8)
    return data


def _edge(data: bytearray, rng: random.Random) -> bytearray:
    data[rng.randrange(len(data))] = rng.choice(_EDGES)
    return data


def _word(data: bytearray, rng: random.Random) -> bytearray:
    """A 16- or 32-bit number, either way round, with a value where programs go wrong."""
    at = rng.randrange(len(data))
    form = rng.choice(("<I", ">I", "<H", ">H"))
    value = rng.choice(_WORDS) & (0xFFFFFFFF if form[1] == "I" else 0xFFFF)
    data[at : at + struct.calcsize(form)] = struct.pack(form, value)
    return data


def _cut(data: bytearray, rng: random.Random) -> bytearray:
    return data[: rng.randrange(len(data) + 1)]


def _remove(data: bytearray, rng: random.Random) -> bytearray:
    at = rng.randrange(len(data))
    del data[at : at + rng.choice((1, 2, 4, 8, 40))]
    return data


def _repeat(data: bytearray, rng: random.Random) -> bytearray:
    at = rng.randrange(len(data))
    piece = data[at : at + rng.choice((1, 4, 16, 100))]
    data[at:at] = piece * rng.choice((1, 2, 50))
    return data


def _move(data: bytearray, rng: random.Random) -> bytearray:
    at, to = rng.randrange(len(data)), rng.randrange(len(data))
    data[to:to] = data[at : at + rng.choice((2, 8, 30))]
    return data


def _insert(data: bytearray, rng: random.Random) -> bytearray:
    at = rng.randrange(len(data) + 1)
    data[at:at] = rng.randbytes(rng.choice((1, 2, 9)))
    return data


def _splice_picture(data: bytearray, rng: random.Random) -> bytearray:
    other = rng.choice(picture_seeds())
    return data[: rng.randrange(len(data) + 1)] + other[rng.randrange(len(other)) :]


def _recompress(data: bytearray, rng: random.Random) -> bytearray:
    """Damage the pixels inside a PNG's compressed stream instead of the stream."""
    chunks = _chunks(data)
    for index, (kind, body) in enumerate(chunks):
        if kind == b"IDAT":
            try:
                pixels = bytearray(zlib.decompress(body))
            except zlib.error:
                return data
            pixels = rng.choice((_flip, _cut, _repeat, _edge))(pixels, rng) if pixels else pixels
            chunks[index] = (kind, zlib.compress(bytes(pixels)))
    return data[:8] + b"".join(struct.pack(">I", len(b)) + k + b + b"\0\0\0\0" for k, b in chunks) if chunks else data


def _chunks(data: bytearray) -> list[tuple[bytes, bytes]]:
    found, at = [], 8
    while data.startswith(b"\x89PNG") and at + 12 <= len(data):
        length = int.from_bytes(data[at : at + 4], "big")
        found.append((bytes(data[at + 4 : at + 8]), bytes(data[at + 8 : at + 8 + length])))
        at += 12 + length
    return found


def _with_sums(data: bytearray) -> bytearray:
    """A PNG whose check sums are right again, so that the damage gets further."""
    parts = [struct.pack(">I", len(b)) + k + b + struct.pack(">I", zlib.crc32(k + b)) for k, b in _chunks(data)]
    return data[:8] + b"".join(parts)


def _number(data: bytearray, rng: random.Random) -> bytearray:
    """Another number in the place of one in a text."""
    places = list(_NUMBER.finditer(bytes(data)))
    if places:
        place = rng.choice(places)
        data[place.start() : place.end()] = rng.choice(_NUMBERS)
    return data


def _markup(data: bytearray, rng: random.Random) -> bytearray:
    at = rng.choice([0, len(data), *(m.start() for m in re.finditer(rb"[<> \"]", bytes(data)))])
    data[at:at] = rng.choice(_XML)
    return data


def _drop_line(data: bytearray, rng: random.Random) -> bytearray:
    lines = bytes(data).split(b"\n")
    del lines[rng.randrange(len(lines))]
    return bytearray(b"\n".join(lines))


def _swap_lines(data: bytearray, rng: random.Random) -> bytearray:
    lines = bytes(data).split(b"\n")
    lines.insert(rng.randrange(len(lines)), lines.pop(rng.randrange(len(lines))))
    return bytearray(b"\n".join(lines))


Way = Callable[[bytearray, random.Random], bytearray]
_COMMON: tuple[Way, ...] = (_flip, _edge, _cut, _remove, _repeat, _move, _insert)
PICTURE_WAYS: tuple[Way, ...] = (*_COMMON, _flip, _edge, _word, _word, _splice_picture, _recompress, _number)
DRAWING_WAYS: tuple[Way, ...] = (*_COMMON, _number, _number, _number, _markup, _markup, _drop_line, _swap_lines)
