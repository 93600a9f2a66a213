"""Layers of a cutout: a file for each colour, between marks in one place."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np
import pytest
from test_structure import pixels, sign

import cubicsplat_cli as cubicsplat
from cubicsplat_cli import UsageError
from cubicsplat_cli.from_options import request_of
from cubicsplat_cli.jobs.plan import plan


@pytest.fixture(scope="module")
def layered():
    """A cutout of a sign, made once, with its layers."""
    return cubicsplat.vectorize(sign(), stacking="cutout", group_by="color", width="80mm", threads=1)


def test_layers_on_one_another_are_the_picture_between_marks_in_one_place(layered):
    made = layered.layers()
    assert [re.fullmatch(r"\d\d-[0-9a-f]{6}", name) is not None for name in made] == [True] * 3
    assert sorted(made) == list(made) and {name[3:] for name in made} == {"ffffff", "000000", "dd2211"}
    pages, marks, roots = [], [], []
    for name, svg in made.items():
        root = ElementTree.fromstring(svg)
        roots.append({key: root.get(key) for key in ("width", "height", "viewBox")})
        assert {shape.get("fill") for shape in root.iter() if shape.get("id") != "register"} - {None} == {
            f"#{name[3::2]}" if name[3::2] == name[4::2] else f"#{name[3:]}"
        }
        page = pixels(svg, "cairosvg", (72, 72))
        marks.append(np.delete(page, np.s_[4:-4], axis=0))
        pages.append(page[4:-4, 4:-4])
    assert roots[0] == {"width": "90mm", "height": "90mm", "viewBox": "-4 -4 72 72"}
    assert roots.count(roots[0]) == 3 and all((mark == marks[0]).all() for mark in marks) and marks[0].max() > 20
    over = np.zeros((64, 64, 4))
    for page in pages:
        over = page + over * (1.0 - page[..., 3:] / 255.0)
    assert np.abs(over - pixels(layered.svg, "cairosvg", (64, 64))).max() <= 2.0


def test_layers_of_overlapping_shapes_are_the_picture_too_and_gradients_are_layers():
    shades = np.zeros((48, 48, 3), np.uint8)
    shades[:, :, 0] = np.linspace(20, 250, 48)[None]
    shades[12:36, 12:36] = (20, 60, 200)
    result = cubicsplat.vectorize(shades, overlap=1.0, threads=1, measure=False)
    made = result.layers()
    assert "Gradient" in result.svg and len(made) == 2
    over = np.zeros((48, 48, 4))
    for svg in made.values():
        page = pixels(svg, size=(54, 54))[3:-3, 3:-3]
        over = page + over * (1.0 - page[..., 3:] / 255.0)
    assert np.abs(over - pixels(result.svg, size=(48, 48))).max() <= 2.0


def test_only_cutouts_have_layers():
    with pytest.raises(UsageError, match="layers are of cutouts"):
        cubicsplat.vectorize(sign(), style="artwork", threads=1, measure=False).layers()
    with pytest.raises(cubicsplat.InputError, match="not written by cubicsplat"):
        from cubicsplat_cli.export.layers import layers

        layers('<svg width="3" height="3"/>')


@pytest.mark.parametrize(
    ("paint", "said"),
    [
        ('fill="red"', "line 2 has the colour 'red', not #rgb or #rrggbb"),
        ("", "line 2 has the colour '', not #rgb or #rrggbb"),
        ('fill="#f00" fill-opacity="half"', "line 2 has 'half' where a number belongs"),
        ('fill="#f00" fill-opacity="2"', "line 2 has the opacity 2, not one in 0..1"),
        ('fill="url(#a)"', "line 2 is filled with #a, which is no gradient in it"),
    ],
)
def test_an_edited_paint_is_refused_with_its_line(paint, said):
    from cubicsplat_cli.export.layers import layers

    with pytest.raises(cubicsplat.InputError, match=re.escape(said)):
        layers(f'<svg width="9" height="9" viewBox="0 0 9 9">\n<path d="M0 0h1v1z" {paint}/></svg>')


def test_the_command_writes_layers_and_removes_those_of_colours_that_are_gone(tmp_path, run_cli):
    sign().save(tmp_path / "a.png")
    out = tmp_path / "layers"
    run = ("vectorize", tmp_path / "a.png", "--layers", out, "--threads", 1, "--no-measure")
    done = run_cli(*run)
    assert done.stderr.strip().endswith(b"3 layers in " + str(out).encode()), done.stderr
    assert [path.name[:4] for path in sorted(out.iterdir())] == ["a-01", "a-02", "a-03"]
    assert '"stacking": "cutout"' in (tmp_path / "a.json").read_text()
    assert run_cli(*run, "--dry-run").stdout.startswith(b"unchanged")
    (missing,) = out.glob("a-*-dd2211.svg")
    content, _ = missing.read_bytes(), missing.unlink()
    assert run_cli(*run, "--dry-run").stdout == f"to do  {tmp_path / 'a.png'} -> {missing}\n".encode()
    done = run_cli(*run)
    assert (b"unchanged" in done.stderr, missing.read_bytes()) == (True, content), "made again without a drawing"
    (out / "a-99-123456.svg").write_text("mine")
    run_cli(*run, "--colors", 2, code=2, error="was not written by cubicsplat")
    (out / "a-99-123456.svg").unlink()
    run_cli(*run, "--colors", 2)
    assert len(list(out.iterdir())) == 2, "the third colour's layer went with it"
    edited = min(out.iterdir())
    edited.write_text(edited.read_text().replace("</svg>", "<!-- mine --></svg>"))
    run_cli(*run, "--colors", 3, code=2, error="was edited")


def test_folders_have_layers_below_as_their_pictures_are(tmp_path, run_cli):
    for name in ("in/a.png", "in/b/a.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        sign(16).save(tmp_path / name)
    request = request_of({"layers": tmp_path / "layers"})
    jobs = plan([str(tmp_path / "in")], str(tmp_path / "out"), request, recursive=True).jobs
    assert [job.outputs.layers for job in jobs] == [tmp_path / "layers" / "a", tmp_path / "layers" / "b" / "a"]
    assert jobs[0].outputs.place("layer 01-ff8800") == tmp_path / "layers" / "a-01-ff8800.svg"
    done = run_cli("vectorize", tmp_path / "in/a.png", tmp_path / "in/b/a.png", "--layers", tmp_path / "layers", code=2)
    assert b"would both give" in done.stderr


@pytest.mark.slow  # two processes start
def test_workers_write_layers(tmp_path, run_cli):
    for name in ("a.png", "b.png"):
        sign(16).save(tmp_path / name)
    run_cli("vectorize", tmp_path, "-j", 2, "--threads", 1, "--svg-only", "--layers", tmp_path / "layers")
    assert {path.name[:2] for path in (tmp_path / "layers").iterdir()} == {"a-", "b-"}
