"""SVG files of others: ordinary ones are drawn, dangerous and broken ones are refused before any renderer sees them."""

from __future__ import annotations

import re
import time

import pytest

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.rerender import rerender_untrusted
from cubicsplat_cli.svg.untrusted import check_untrusted

BOTH = pytest.mark.parametrize("renderer", ["cairosvg", "resvg"])

XLINK = 'xmlns:xlink="http://www.w3.org/1999/xlink"'
OPEN_TAG = f'<svg xmlns="http://www.w3.org/2000/svg" {XLINK} width="20" height="10">'


def foreign(body: str, before: str = "") -> bytes:
    return f"{before}{OPEN_TAG}{body}</svg>".encode()


@BOTH
def test_ordinary_files_of_others_are_drawn(renderer):
    doctype = '<!DOCTYPE svg PUBLIC "-//W3C//DTD SVG 1.1//EN" "http://www.w3.org/Graphics/SVG/1.1/DTD/svg11.dtd">'
    body = (
        "<style>.a{fill:url(#g)}</style>"
        '<defs><linearGradient id="g"><stop stop-color="#f00"/></linearGradient>'
        '<rect id="r" width="10" height="10"/></defs>'
        '<a href="https://example.org"><use xlink:href="#r" class="a"/></a>'
    )
    rendered, size = rerender_untrusted(foreign(body, doctype), source="x.svg", scale=2, renderer=renderer)
    assert (size.width, size.height) == (20, 10)
    assert rendered.pixels.shape == (20, 40, 4)
    assert rendered.pixels[10, 5].tolist() == [255, 0, 0, 255]
    assert rendered.pixels[10, 30, 3] == 0


@BOTH
def test_other_shapes_are_centred(renderer):
    svg = b'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 10 10"><rect width="10" height="10"/></svg>'
    rendered, _ = rerender_untrusted(svg, source="x.svg", width=30, height=10, renderer=renderer)
    assert rendered.pixels.shape == (10, 30, 4)
    opaque = rendered.pixels[5, :, 3] == 255
    assert opaque.tolist() == [False] * 10 + [True] * 10 + [False] * 10


@BOTH
@pytest.mark.parametrize(
    ("svg", "said"),
    [
        (b"", "empty"),
        (b"  \n", "empty"),
        (b"GIF89a", "is no SVG; give an SVG file"),
        (b"<svg", "well-formed"),
        (b"<html/>", "no SVG"),
        (b"\x1f\x8b\x08rest", "gunzip"),
        (foreign("")[:-5], "well-formed"),
        (foreign("", '<!DOCTYPE svg [<!ENTITY a "b">]>'), "entity"),
        (foreign("", '<!DOCTYPE svg [<!ENTITY % a SYSTEM "file:///etc/passwd"> %a;]>'), "entity"),
        (foreign('<image href="data:image/png;base64,AAAA"/>'), "<image>"),
        (foreign('<image xlink:href="file:///etc/hostname"/>'), "<image>"),
        (foreign('<x:image xmlns:x="http://www.w3.org/2000/svg" href="a.png"/>'), "<image>"),
        (foreign('<filter><feImage href="http://localhost/"/></filter>'), "<feImage>"),
        (foreign("<foreignObject/>"), "<foreignObject>"),
        (foreign('<use xlink:href="other.svg#a"/>'), "outside"),
        (foreign('<use href="http://localhost/a.svg#a"/>'), "outside"),
        (foreign('<rect width="9" height="9" fill="url(http://localhost/#a)"/>'), "outside"),
        (foreign("<rect style=\"fill:url('//localhost/#a')\"/>"), "outside"),
        (foreign("<style>@import 'http://localhost/a.css';</style>"), "outside"),
        (foreign("<style>rect{fill:url( a.svg#b )}</style>"), "outside"),
        (foreign("", '<?xml-stylesheet href="http://localhost/a.css"?>'), "outside"),
        (b'<svg xmlns="http://www.w3.org/2000/svg"/>', "no size"),
        (b'<svg xmlns="http://www.w3.org/2000/svg" width="100%" height="1e999"/>', "no size"),
        (b'<svg xmlns="http://www.w3.org/2000/svg" width="0" height="5"/>', "no size"),
        (foreign("<g>" * 300 + "</g>" * 300), "levels"),
        (b'<?xml version="1.0" encoding="nonsense"?>' + foreign(""), "encoding|well-formed"),
    ],
)
def test_dangerous_or_broken_files_are_refused(svg, said, renderer, monkeypatch):
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("a file made us open a connection"))
    with pytest.raises(InputError, match=said):
        rerender_untrusted(svg, source="x.svg", renderer=renderer)


def test_files_over_the_size_limit_are_refused():
    with pytest.raises(InputError, match="at most 67108864 bytes"):
        rerender_untrusted(foreign(" " * (1 << 26)), source="x.svg")


@pytest.mark.parametrize(
    ("body", "renderer", "reason"),
    [
        ('<rect width="5" height="3" opacity="x"/>', "cairosvg", " ('x' is no number)"),
        ('<rect width="5" height="3" stroke-dasharray="-1 2" stroke="red"/>', "cairosvg", " (invalid value for a "),
        ('<marker id="m" markerWidth="x"/><path d="M0 0L3 3" marker-end="url(#m)"/>', "cairosvg", "; check the file"),
        ('<x:rect width="5"/>', "resvg", " (an unknown namespace prefix 'x' at"),
        ('<circle r="1e15"/>', "resvg", ""),
    ],
)
def test_what_a_renderer_cannot_draw_is_one_line_with_the_files_name(body, renderer, reason, monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.svg.untrusted.MAX_RADIUS", 1e20)
    with pytest.raises(InputError) as refused:
        rerender_untrusted(foreign(body), source="x.svg", renderer=renderer)
    assert str(refused.value).startswith(f"x.svg: {renderer} cannot draw it{reason}")
    assert not re.search(r"Error|None|float|recursion|Exception|CAIRO", str(refused.value))


def chain(kind: str) -> str:
    name, held = ("g", '<use href="#a{}"/>') if kind == "use" else ("pattern", '<path style="fill: url( #a{} )"/>')
    levels = [f'<{name} id="a{i}">{held.format(i - 1) * 10}</{name}>' for i in range(1, 30)]
    return f'<defs><rect id="a0"/>{"".join(levels)}</defs>{held.format(29)}'


@pytest.mark.parametrize(
    "body", [chain("use"), chain("fill"), '<g id="a"><g><use href="#a"/></g></g>', '<circle r="1e400"/>']
)
def test_what_would_be_drawn_without_end_is_refused_at_once(body):
    began = time.process_time()
    with pytest.raises(InputError, match=r"^x.svg: (draws more than|has references to themselves|has r='1e400')"):
        check_untrusted(foreign(body), "x.svg")
    assert time.process_time() - began < 0.5


def test_a_long_number_takes_no_longer_than_its_length():
    began = time.process_time()
    assert check_untrusted(foreign(f'<circle r="{"1" * 20_000}x"/>'), "x.svg").width == 20
    assert time.process_time() - began < 0.5


def test_gradients_of_many_shapes_and_uses_of_few_are_no_bombs():
    gradient = '<linearGradient id="g"><stop/><stop offset="1"/></linearGradient><rect id="r" width="1" height="1"/>'
    body = gradient + '<rect width="1" height="1" fill="url(#g)"/>' * 40_000 + '<use href="#r"/>' * 40_000
    assert check_untrusted(foreign(body), "x.svg").width == 20


@pytest.mark.parametrize("scale", [0, -1, float("nan"), float("inf")])
def test_scale_must_be_positive(scale):
    with pytest.raises(UsageError, match="scale"):
        rerender_untrusted(foreign(""), source="x.svg", scale=scale)
