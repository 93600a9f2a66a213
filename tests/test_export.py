"""Files for other programs: PDF, PS, EPS, DXF and VectorDrawable, each read back."""

from __future__ import annotations

import io
import re
import zlib
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np
import pytest
from outline_loops import farthest

from benchmarks.artwork.pixels import psnr
from cubicsplat_cli.artwork.geometry.outlines import points_at
from cubicsplat_cli.errors import EngineError, InputError
from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.export.dxf import MM_PER_PX, arcs_along
from cubicsplat_cli.export.formats import exported
from cubicsplat_cli.files.paths import EXPORTS
from cubicsplat_cli.svg.paths import cubic_subpaths

OF_CAIRO = ("pdf", "ps", "eps")
ANDROID = "{http://schemas.android.com/apk/res/android}"
RECTANGLE = '<rect x="8" y="4" width="16" height="12" fill="#ff8800"/>'
TRANSLUCENT = '<circle cx="20" cy="10" r="6" fill="#0044cc" fill-opacity=".5"/>'
RADIAL = (
    '<radialGradient id="e" cx="0" cy="0" r="1" gradientUnits="userSpaceOnUse" gradientTransform="{}">'
    '<stop offset="0" stop-color="red"/><stop offset="1" stop-color="#00f" stop-opacity=".5"/></radialGradient>'
)
# What VectorDrawable can say, on 64 x 48 px.
RICH = {
    "opacities": f'<g opacity=".5" transform="rotate(10)">{RECTANGLE}</g>{TRANSLUCENT}',
    "even-odd": '<path d="M4 4H60V44H4ZM12 12H52V36H12ZM20 18V30H44V18Z" fill-rule="evenodd" fill="teal"/>',
    "strokes": '<path d="M6 40C20 0 40 0 58 40" fill="none" stroke="purple" stroke-width="5" stroke-linecap="round"/>'
    '<path d="M30 44H58V30Z" fill="none" stroke="#080" stroke-width="2" stroke-linejoin="bevel" stroke-opacity=".7"/>',
    "dashes": '<path d="M4 40 30 6 60 30" fill="none" stroke="purple" stroke-width="4" stroke-dasharray="7 3 2 3"/>'
    '<rect x="20" y="24" width="24" height="18" fill="#ff0" stroke="#080" stroke-width="3" stroke-linecap="round" '
    'stroke-dasharray="6" stroke-dashoffset="4"/>',
    "linear": '<linearGradient id="l"><stop stop-color="red"/><stop offset="1" stop-color="yellow"/></linearGradient>'
    '<path d="M4 4h50v10q-9 20-50 9z" fill="url(#l)" transform="skewX(20)"/>',
    "radial": RADIAL.format("translate(30 20)scale(20)") + '<rect width="64" height="48" fill="url(#e)"/>',
    "elliptical": RADIAL.format("translate(30 20)rotate(30)scale(25 9)")
    + '<ellipse cx="30" cy="22" rx="26" ry="18" fill="url(#e)" stroke="#040" stroke-width="4"/>',
    "uses": f'<defs><g id="u">{RECTANGLE}</g></defs><use href="#u" x="20" y="9"/><style>.c{{fill:#123}}</style>'
    '<rect class="c" width="9" height="9" rx="3"/>',
}


def skip_without_ezdxf() -> None:
    pytest.importorskip("ezdxf", reason="needs ezdxf: pip install 'cubicsplat[test]'")


def svg_of(body: str, size: str = 'width="64" height="48" viewBox="0 0 64 48"') -> bytes:
    return f'<svg xmlns="http://www.w3.org/2000/svg" {size}>{body}</svg>'.encode()


class Exported(NamedTuple):
    data: bytes
    notes: list[str]


def made(body: str, form: str, **options: float) -> Exported:
    return Exported(*exported(svg_of(body), form, "x.svg", **options))


def pdf_content(data: bytes) -> str:
    """The drawing operators of a PDF: of its page and its groups."""
    streams = re.findall(rb"stream\r?\n(.*?)\r?\nendstream", data, re.DOTALL)
    return "\n".join(zlib.decompress(stream).decode("latin-1") for stream in streams)


@pytest.mark.parametrize("form", OF_CAIRO)
def test_pages_hold_vectors_and_have_the_size_of_the_svg(form):
    page = made(RECTANGLE + '<circle cx="40" cy="20" r="8" fill="#08f"/>' + RICH["linear"], form)
    text = pdf_content(page.data) if form == "pdf" else page.data.partition(b"%%Page:")[2].decode("latin-1")
    assert page.notes == []
    assert len(re.findall(r"\bf\*?$", text, re.MULTILINE)) == 2, "two flat fills"
    assert b"/Image" not in page.data and b"ShadingType 2" in page.data
    assert re.search(r"^6 3 12 9 re f", text, re.MULTILINE), "px are 0.75 pt"
    if form == "pdf":
        assert re.search(rb"/MediaBox \[ 0 0 48 36 \]", page.data)
    elif form == "eps":
        assert page.data.startswith(b"%!PS-Adobe-3.0 EPSF") and b"\n%%BoundingBox: 0 0 48 36\n" in page.data
    else:
        assert re.search(rb"%%DocumentMedia: \S+ 48 36 ", page.data)


def test_the_box_of_an_eps_begins_where_its_page_does():
    data = exported(svg_of(RECTANGLE, 'width="33" height="301"'), "eps", "x.svg")[0]
    assert b"\n%%BoundingBox: 0 0 25 226\n%%HiResBoundingBox: 0 0.25 24.75 226\n" in data


def test_only_postscript_makes_pixels_of_what_is_translucent_and_says_so():
    assert not made(RECTANGLE + TRANSLUCENT, "pdf").notes
    assert re.search(r"/a1 gs|/a\d gs", pdf_content(made(RECTANGLE + TRANSLUCENT, "pdf").data))
    for form in ("ps", "eps"):
        page = made(RECTANGLE + TRANSLUCENT, form)
        assert b"/ImageType 1" in page.data
        assert [note for note in page.notes if note.startswith(f"{form.upper()} has no opacity: ")] == page.notes != []


def test_the_pixels_of_a_large_page_fit_into_memory():
    data = exported(svg_of(RECTANGLE + TRANSLUCENT, 'width="20000" height="20000"'), "eps", "x.svg")[0]
    assert int(re.search(rb"% Fallback Image: .* res=(\d+)[.\d]*ppi", data)[1]) < 50


@pytest.mark.parametrize("form", EXPORTS)
def test_a_drawing_of_nothing_is_an_empty_file_of_its_size(form):
    if form == "dxf":
        skip_without_ezdxf()
    empty = made("", form)
    assert empty.notes == [] and len(empty.data) > 200
    if form == "xml":
        root = ElementTree.fromstring(empty.data)
        assert (len(root), root.get(f"{ANDROID}viewportWidth"), root.get(f"{ANDROID}height")) == (0, "64", "48dp")


# ---- DXF


def read_dxf(data: bytes):
    import ezdxf

    document = ezdxf.read(io.StringIO(data.decode()))
    assert not document.audit().errors
    return document


def test_a_dxf_has_closed_outlines_in_millimetres_on_layers_by_colour():
    skip_without_ezdxf()
    document = read_dxf(made(f'{RECTANGLE}<path d="M2 2V9Q9 20 14 3" fill="#08f" fill-opacity=".4"/>', "dxf").data)
    first, second = document.modelspace()
    assert document.units == 4 and document.header["$MEASUREMENT"] == 1
    assert (first.dxf.layer, second.dxf.layer, first.closed, second.closed) == ("#ff8800", "#0088ff", True, True)
    assert document.layers.get("#0088ff").rgb == (0, 0x88, 0xFF)
    corners = {(round(x / MM_PER_PX, 6), round(y / MM_PER_PX, 6)) for x, y in first.get_points("xy")}
    assert corners == {(8.0, 44.0), (24.0, 44.0), (8.0, 32.0), (24.0, 32.0)}, "y up, on a canvas of 48 px"


def test_a_stroke_in_a_dxf_is_its_centre_line_with_its_width():
    skip_without_ezdxf()
    body = '<path d="M4 4H60L30 40" fill="none" stroke="red" stroke-width="4"/>'
    (line,) = read_dxf(made(f'<g transform="scale(.5)">{body}</g>', "dxf").data).modelspace()
    assert not line.closed and len(line) == 3
    assert line.dxf.const_width == pytest.approx(2.0 * MM_PER_PX)


def test_a_gradient_is_a_layer_of_its_mean_colour():
    skip_without_ezdxf()
    (outline,) = read_dxf(made(RICH["linear"], "dxf").data).modelspace()
    assert outline.dxf.layer == "#ff8000"


PATHS = [
    "M10 20C30 -20 50 60 60 12S5 90 10 20Z",  # inflections
    "M0 0C80 60 -20 60 60 0Z",  # a loop
    "M0 0C40 40 40 40 0 0.5Z",  # nearly a cusp
    "M5 5C5 5 30 9 30 30S5 30 5 5",  # handles of no length
    "M20 5a15 15 0 0 1 0 30a9 15 40 1 1 0 -30",
    "M1 1H50V30H1Z",
]


@pytest.mark.parametrize("tolerance", [0.5, 0.02])
def test_arcs_are_within_the_tolerance_of_the_outline(tolerance):
    skip_without_ezdxf()
    from ezdxf.path import make_path

    for data in PATHS:
        outlines = read_dxf(made(f'<path d="{data}"/>', "dxf", tolerance=tolerance).data).modelspace()
        (cubics,) = (line.ring() for line in cubic_subpaths(data))
        (outline,) = ([(p.x, p.y) for p in make_path(each).flattening(0.02 * tolerance)] for each in outlines)
        drawn = np.array(outline) / MM_PER_PX * [1.0, -1.0] + [0.0, 48.0]
        wanted = points_at(cubics, np.linspace(0.0, 1.0, 200)).reshape(-1, 2)
        assert farthest(wanted, drawn) <= 1.1 * tolerance and farthest(drawn, wanted) <= 1.1 * tolerance + 0.3, data


def test_circles_are_arcs_lines_are_lines_and_a_smaller_tolerance_takes_more():
    (circle,) = cubic_subpaths("M10 0A10 10 0 0 1 -10 0A10 10 0 0 1 10 0Z")
    vertices = arcs_along(circle.cubics, 0.01)
    assert len(vertices) == 8 and np.allclose(vertices[:, 2], np.tan(np.pi / 16.0), atol=1e-3)
    (square,) = cubic_subpaths("M0 0H9V9H0Z")
    assert arcs_along(square.ring(), 0.01).tolist() == [[0, 0, 0], [9, 0, 0], [9, 9, 0], [0, 9, 0]]
    (bent,) = cubic_subpaths(PATHS[0])
    assert len(arcs_along(bent.cubics, 0.001)) > len(arcs_along(bent.cubics, 0.1)) > 6


def test_what_would_take_too_many_arcs_is_refused():
    (bent,) = cubic_subpaths(PATHS[0])
    with pytest.raises(InputError, match="arcs; give a larger --dxf-tolerance"):
        arcs_along(bent.cubics, 1e-9, most=99)


# ---- VectorDrawable


def as_svg(data: bytes) -> bytes:
    """A VectorDrawable as an SVG, by what Android's documentation says of each attribute."""
    root = ElementTree.fromstring(data)
    definitions: list[str] = []
    sizes = " ".join(f'{name}="{root.get(f"{ANDROID}viewport{name.title()}")}"' for name in ("width", "height"))
    body = "".join(_element_as_svg(element, definitions) for element in root)
    return f'<svg xmlns="http://www.w3.org/2000/svg" {sizes}><defs>{"".join(definitions)}</defs>{body}</svg>'.encode()


def _element_as_svg(element: ElementTree.Element, definitions: list[str]) -> str:
    def value(name: str, default: str = "") -> str:
        return element.get(ANDROID + name, default)

    if element.tag == "group":
        move = f"translate({value('translateX')} {value('translateY')})rotate({value('rotation')})"
        inside = "".join(_element_as_svg(child, definitions) for child in element)
        return f'<g transform="{move}scale({value("scaleX", "1")} {value("scaleY", "1")})">{inside}</g>'
    paints = {name: value(f"{name}Color", "none") for name in ("fill", "stroke")}
    for attribute in element:
        name = attribute.get("name").removeprefix("android:").removesuffix("Color")
        paints[name] = f"url(#g{len(definitions)})"
        definitions.append(_gradient_as_svg(attribute[0], f"g{len(definitions)}"))
    attributes = {
        "d": value("pathData"), "fill-rule": value("fillType", "nonZero").lower(),
        "stroke-width": value("strokeWidth", "0"), "stroke-linecap": value("strokeLineCap", "butt"),
        "stroke-linejoin": value("strokeLineJoin", "miter"), **paints,
        **{f"{name}-opacity": value(f"{name}Alpha", "1") for name in paints},
    }  # fmt: skip
    return ElementTree.tostring(ElementTree.Element("path", attributes), encoding="unicode")


def _gradient_as_svg(gradient: ElementTree.Element, name: str) -> str:
    places = {"startX": "x1", "startY": "y1", "endX": "x2", "endY": "y2", "centerX": "cx", "centerY": "cy"}
    places["gradientRadius"] = "r"
    given = {key.removeprefix(ANDROID): text for key, text in gradient.attrib.items()}
    kind = f"{given['type']}Gradient"
    said = " ".join(f'{places[key]}="{text}"' for key, text in given.items() if key in places)
    stops = ""
    for item in gradient:
        colour = item.get(f"{ANDROID}color")
        opacity = int(colour[1:3], 16) / 255
        stops += f'<stop offset="{item.get(f"{ANDROID}offset")}" stop-color="#{colour[3:]}" stop-opacity="{opacity}"/>'
    return f'<{kind} id="{name}" gradientUnits="userSpaceOnUse" {said}>{stops}</{kind}>'


@pytest.mark.parametrize("name", RICH)
def test_a_vector_drawable_is_drawn_alike(name):
    drawable = made(RICH[name], "xml")
    assert drawable.notes == []
    svgs = svg_of(RICH[name]), as_svg(drawable.data)
    expected, found = (rerender(svg, 64, 48, renderer="resvg").pixels for svg in svgs)
    assert expected[..., 3].max() > 100
    assert psnr(expected, found) > 44.0


def test_a_short_path_stays_one_though_its_parts_lie_apart():
    drawable = made('<path d="M1 1h9v9h-9ZM70 50h9v9h-9Z"/>', "xml")
    assert len(ElementTree.fromstring(drawable.data)) == 1


def test_too_long_a_path_is_split_where_its_parts_lie_apart_and_else_left_out():
    teeth = "".join(f"L{i % 60}.{i % 97:02d} {(7 * i) % 40}.{(13 * i) % 89:02d}" for i in range(4000))
    square = "M70 50h9v9h-9Z"
    drawable = made(f'<path d="M1 1{teeth}Z{square}M90 50h9v9h-9Z"/>{RECTANGLE}', "xml")
    paths = [path.get(f"{ANDROID}pathData") for path in ElementTree.fromstring(drawable.data)]
    assert len(paths) == 3 and max(map(len, paths)) < 100
    assert drawable.notes == ["left out: 1 path of more than 32767 characters"]


def test_a_dashed_stroke_without_a_width_is_no_path():
    body = '<rect width="9" height="9" fill="red" stroke="blue" stroke-width="0" stroke-dasharray="2"/>'
    assert made(body, "xml").data.count(b"<path") == 1


def test_what_no_format_of_shapes_holds_is_said():
    body = '<text x="3" y="20">Hi</text><clipPath id="c"><path d="M0 0h9v9z"/></clipPath><pattern id="p"/>'
    body += '<path d="M0 0h9v9z" clip-path="url(#c)" stroke="red" stroke-dasharray="3"/>'
    body += '<path d="M0 0h9v9z" fill="url(#p)"/>'
    assert made(body, "xml").notes == ["left out: 1 clip-path, 1 pattern, 1 text"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("form", ["dxf", "xml"])
def test_what_is_too_far_away_or_cannot_be_read_is_left_out_and_said(form):
    if form == "dxf":
        skip_without_ezdxf()
    stops = '<stop stop-color="nonsense"/><stop offset="1" stop-color="red"/>' + 1000 * '<stop offset="1"/>'
    body = f'<linearGradient id="g">{stops}</linearGradient><rect width="9" height="9" fill="url(#g)"/>'
    drawing = made(f'{body}<g transform="scale(1e20)">{RECTANGLE}</g><path d="M1 2C"/>', form)
    expected = "1 path that cannot be read, 1 rect beyond 4000000 px, 2 stops, 1 stop that cannot be read"
    assert drawing.notes == [f"left out: {expected}"]


@pytest.mark.parametrize("size", [{"width": 128.0}, {"scale": 2.0}, {"width": 128.0, "height": 96.0}])
def test_sizes_that_are_asked_for(size):
    skip_without_ezdxf()
    assert b"/MediaBox [ 0 0 96 72 ]" in made(RECTANGLE, "pdf", **size).data
    assert b'viewportWidth="128"' in made(RECTANGLE, "xml", **size).data
    (outline,) = read_dxf(made(RECTANGLE, "dxf", **size).data).modelspace()
    assert max(x for x, _ in outline.get_points("xy")) == pytest.approx(48.0 * MM_PER_PX)


def test_without_libcairo_pages_say_how_to_get_it(package):
    package("cairosvg", "raise OSError('no library called cairo')")
    with pytest.raises(EngineError, match=r"the renderer cairosvg is not available: .*cairo"):
        made(RECTANGLE, "pdf")
    assert made(RECTANGLE, "xml").data


def test_the_focus_of_a_gradient_is_left_out_of_a_drawable_and_said():
    stops = '<stop stop-color="#f00"/><stop offset="1" stop-color="#00f"/>'
    gradients = (
        f'<radialGradient id="a" fx=".3">{stops}</radialGradient><radialGradient id="b">{stops}</radialGradient>'
    )
    body = f'{gradients}<path d="M1 1h9v9z" fill="url(#a)"/><path d="M20 1h9v9z" fill="url(#b)"/>'
    assert made(body, "xml").notes == ["left out: 1 focus of a gradient"]
