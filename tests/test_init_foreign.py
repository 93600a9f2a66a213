"""`--init` with SVGs of other programs: what is read of them, and what is said of the rest."""

from __future__ import annotations

import numpy as np
import pytest
from cli_runs import strict_json
from PIL import Image

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.evaluate.rerender import rerender_untrusted
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.initial import load_initial_drawing

ROOT = '<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
EDITOR = f"""<?xml version="1.0" encoding="UTF-8" standalone="no"?>
{ROOT} xmlns:i="http://www.inkscape.org/namespaces/inkscape" width="100mm" height="80mm" viewBox="0 0 100 80">
<i:namedview i:zoom="1"/><defs/>
<g i:label="Layer 1" transform="translate(5,3)">
<rect style="fill:#2e86ab;stroke:#1b1b1e;stroke-width:2.5;stroke-linejoin:round" width="40" height="25" x="5"
 y="5" ry="4"/>
<path style="fill:#f18f01;fill-rule:evenodd" d="m 60,10 c 10,0 20,10 20,20 0,10 -10,20 -20,20 -10,0 -20,-10 -20,-20
 0,-10 10,-20 20,-20 z m 0,10 c -5,0 -10,5 -10,10 0,5 5,10 10,10 5,0 10,-5 10,-10 0,-5 -5,-10 -10,-10 z"/>
<path style="fill:none;stroke:#c73e1d;stroke-width:3;stroke-linecap:round" d="M 5,45 C 15,35 25,60 40,50 L 48,70"
 transform="matrix(1,0.1,-0.1,1,2,0)"/>
<ellipse cx="20" cy="62" rx="12" ry="6" style="fill:#3b1f2b;opacity:0.6" transform="rotate(-20 20 62)"/></g></svg>"""
SHEET = f"""{ROOT} viewBox="0 0 200 150"><style>/* of an export */
.st0{{fill:#FFD23F;}} circle, #t {{fill-opacity:.8}}
.st1{{fill:none;stroke:#0EAD69;stroke-width:6;stroke-miterlimit:10;}}</style>
<circle class="st0" cx="60" cy="60" r="40"/><polygon class="st1" points="120,20 180,40 150,100 "/>
<rect id="t" x="20" y="110" style="fill:rgb(10%,20%,90%)" width="80%" height="30"/></svg>"""
ICON = f"""{ROOT} width="24" height="24" viewBox="0 0 24 24" fill="none" stroke="currentColor" stroke-width="2"
 stroke-linecap="round" stroke-linejoin="round"><rect x="3" y="4" width="18" height="18" rx="2"/>
<line x1="16" y1="2" x2="16" y2="6"/><polyline points="7 15 10 18 17 12"/></svg>"""
SPRITE = f"""{ROOT} width="120" height="60"><defs><symbol id="s" viewBox="0 0 10 10">
<circle cx="5" cy="5" r="4" fill="red"/><path d="M1 5h8" stroke="white" stroke-linecap="square" fill="none"/></symbol>
<g id="g"><rect width="20" height="20"/></g></defs><use xlink:href="#s" x="5" y="5" width="40" height="40"/>
<use href="#g" x="60" y="10" fill="green"/>
<use href="#g" transform="translate(95 10) rotate(45 10 10) skewX(10)" fill="rgba(0,0,255,.5)"/></svg>"""
TRACED = f"""{ROOT} width="200pt" height="150pt" viewBox="0 0 200 150"><g transform="translate(0,150) scale(0.1,-0.1)"
 stroke="none"><path d="M200 1000 c-50 -50 -50 -200 0 -250 50 -50 200 -50 250 0 50 50 50 200 0 250 -50 50 -200 50 -250
 0z m200 -50 c30 -30 30 -120 0 -150 -30 -30 -120 -30 -150 0 -30 30 -30 120 0 150 30 30 120 30 150 0z
 M1000 500 l300 0 0 300 -300 0z"/></g></svg>"""
ARCS = f"""{ROOT} viewBox="0 0 512 512"><path fill="#f44" d="M256 32a224 224 0 1 0 0 448A224 224 0 1 0 256 32zm0 100a40
 40 0 110 80 40 40 0 010-80"/><path d="m100 300 50-50 50 50t50 50 50-50q20-40 60 0l.5.5-1e1 3" fill="none" stroke="#00f"
 stroke-width="10"/><path d="M60 60 A 30 10 30 0 0 140 140" fill="none" stroke="#080" stroke-width="6"/></svg>"""


def level(svg: str) -> float:
    """dB between a scene that is begun with and what an independent renderer draws of the file, over white."""
    scene = load_initial_drawing(svg.encode()).scene
    size = (240, round(240 * scene.height / scene.width))
    own = render_scene(scene.scaled(*size), threads=1)
    drawn = rerender_untrusted(svg.encode(), source="x.svg", width=size[0], height=size[1])[0].pixels / 255.0
    own, drawn = own[..., :3] + 1 - own[..., 3:], drawn[..., :3] * drawn[..., 3:] + 1 - drawn[..., 3:]
    assert drawn.min() < 0.5
    return float(-10 * np.log10(np.square(own - drawn).mean()))


@pytest.mark.parametrize(
    ("svg", "curves"), [(EDITOR, 5), (SHEET, 3), (ICON, 3), (SPRITE, 4), (TRACED, 2), (ARCS, 3)],
    ids=["editor", "sheet", "icon", "sprite", "traced", "arcs"],
)  # fmt: skip
def test_a_scene_is_what_the_file_shows(svg, curves):
    found = load_initial_drawing(svg.encode())
    assert (found.scene.curves, found.notes) == (curves, ())
    found.scene.validate()
    assert level(svg) > 36


@pytest.mark.parametrize("join", ["miter", "round", "bevel"])
@pytest.mark.parametrize("cap", ["butt", "round", "square"])
def test_strokes_are_what_they_cover(join, cap):
    path = f'<path d="M30 70L100 30 170 120C120 120 60 80 40 130" stroke-linejoin="{join}" stroke-linecap="{cap}"'
    both = f'{path} fill="none" stroke="#06c" stroke-width="16"/>'
    closed = f'<path d="M120 20h40v30z" fill="none" stroke="#c00" stroke-width="8" stroke-linejoin="{join}"/>'
    assert level(f'{ROOT} viewBox="0 0 200 150">{both}{closed}</svg>') > 30


def test_strokes_are_read_as_strokes_where_these_are_wanted():
    found = load_initial_drawing(EDITOR.encode(), Mode.OPEN)
    scene = found.scene
    assert (scene.mode, scene.curves) == (Mode.OPEN, 2)
    assert scene.half_widths.tolist() == pytest.approx([1.5 * (1.01**0.5) * 1024 / 100, 1.25 * 1024 / 100], rel=1e-3)
    assert found.notes == ("the SVG: left out of the drawing to begin with: 3 fills",)
    with pytest.raises(InputError, match="shows no stroke that could be begun with; --mode closed"):
        load_initial_drawing(TRACED.encode(), Mode.OPEN)


def test_what_is_left_out_is_said_in_a_line():
    body = """<linearGradient id="g"><stop stop-color="#f00"/><stop offset="1" style="stop-color:#00f;stop-opacity:.5"/>
    </linearGradient><linearGradient id="h" xlink:href="#g"/><rect width="50" height="50" fill="url(#h)"/><text>a</text>
    <g clip-path="url(#c)"><path d="M0 0h9v9z" stroke="red" stroke-dasharray="2 1"/></g><path d="M oops"/>
    <rect width="9" height="9" fill="url(#none)"/><g display="none"><circle r="5"/></g>"""
    found = load_initial_drawing(f'{ROOT} width="50" height="50">{body}</svg>'.encode())
    left_out = "1 clip-path, 1 path that cannot be read, 1 pattern, 1 text"
    assert found.notes == (
        f"the SVG: left out of the drawing to begin with: {left_out}",
        "the SVG: begun with the mean colours of 1 gradient",
    )
    assert found.scene.curves == 2 + 11  # fills, and dashes on 30.7 px
    # A stop counts by its opacity.
    assert found.scene.colours[-1].tolist() == pytest.approx([2 / 3, 0, 1 / 3], abs=1 / 255)
    assert float(found.scene.opacities[-1]) == pytest.approx(0.75, abs=1 / 255)


LAUGHS = "".join(f'<g id="a{i + 1}">{f"""<use href="#a{i}"/>""" * 10}</g>' for i in range(9))


BOX = '<rect width="9" height="9"/>'


@pytest.mark.parametrize(
    ("svg", "said"),
    [
        (
            f'{ROOT} width="9" height="9"><defs><g id="a0"><rect/></g>{LAUGHS}</defs><use href="#a9"/></svg>',
            "draws more",
        ),
        (f'{ROOT} width="9" height="9"><g id="a"><use href="#a"/></g></svg>', "in one another"),
        (f'{ROOT} width="9" height="9"/>', "shows no filled shape"),
        (f'{ROOT} width="9" height="9">{"<rect/>" * 200_001}</svg>', "draws more than 200000 elements; simplify it"),
        (
            f'{ROOT} width="9" height="9"><g transform="matrix(1 2)">{BOX}</g></svg>',
            "lacks numbers",
        ),
        (
            f'{ROOT} width="9" height="9"><g opacity="much">{BOX}</g></svg>',
            "'much' is no length",
        ),
        (f'{ROOT} width="9" height="9"><image href="a.png"/></svg>', "holds a <image> element"),
        (f'{ROOT} width="9" height="9"><path d="M0 0h1e999v1z"/></svg>', "shows no filled shape"),
        (f"{ROOT}><rect/></svg>", "says no size"),
        ("<html/>", "is XML but no SVG"),
        ("no svg", "is no SVG"),
        ("<svg", "not well-formed"),
    ],
)
def test_what_cannot_be_begun_with_is_one_line(svg, said):
    with pytest.raises(InputError, match=said) as found:
        load_initial_drawing(svg.encode())
    assert str(found.value).startswith("the SVG: ")
    assert "\n" not in str(found.value)


PATH = '<path d="M0 0h9v9"/>'


@pytest.mark.parametrize("path", ["M0 0l" + "1 1 " * 40, "m0 0h1" * 40, "h1v1" * 20])
def test_a_path_without_end_is_refused_before_it_is_read(path, monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.svg.paths.MAX_COMMANDS", 30)
    for body in (f'<path d="{path}" fill="red"/>', f'<polyline points="0 0 {"1 1 " * 40}"/>'):
        with pytest.raises(InputError, match=r"^the SVG: path data of more than 30 commands.*; simplify it$"):
            load_initial_drawing(f'{ROOT} width="9" height="9">{body}</svg>'.encode())
    monkeypatch.setattr("cubicsplat_cli.svg.painted.MAX_COMMANDS", 30)
    with pytest.raises(InputError, match="more than 30 segments; simplify it"):
        load_initial_drawing(f'{ROOT} width="9" height="9">{20 * PATH}</svg>'.encode())


def test_the_command_refines_the_drawing_of_another_program(tmp_path, run_cli):
    (tmp_path / "drawn.svg").write_text(EDITOR.replace("</svg>", "<text>a</text></svg>"))
    drawn = rerender_untrusted(EDITOR.encode(), source="x", width=120, height=96)[0].pixels
    picture = Image.new("RGB", (120, 96), "white")
    image = Image.fromarray(drawn)
    picture.paste(image, mask=image)
    picture.save(tmp_path / "a.png")
    arguments = ["--preset", "draft", "--steps", 30, "--threads", 1, "--background", "white", "--json"]
    done = run_cli("vectorize", tmp_path / "a.png", "--init", tmp_path / "drawn.svg", *arguments)
    assert b"drawn.svg: left out of the drawing to begin with: 1 text" in done.stderr
    found = strict_json(done.stdout)
    assert found["output"]["paths"] <= 5
    assert found["quality"]["svg"]["psnr_db"] > 30
