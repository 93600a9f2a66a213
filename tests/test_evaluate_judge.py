"""The comparison of one candidate, folders matched by name, and figures as tables."""

from __future__ import annotations

import csv
import io
import math
from pathlib import Path

import numpy as np
import pytest
from conftest import smooth_pixels
from image_files import encode
from PIL import Image
from scenes import PAPER, random_scene

from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.evaluate.comparison import compare_with
from cubicsplat_cli.files.load import Picture, load_picture
from cubicsplat_cli.files.names import match_folders, pictures_in
from cubicsplat_cli.files.write import encode_png
from cubicsplat_cli.formatting import csv_text, number, text_table
from cubicsplat_cli.metrics import plain, to_json
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.scene_writer import write_svg

SCENE = random_scene(Mode.CLOSED, curves=9, width=40, height=28, background=PAPER, seed=6)
SVG = write_svg(SCENE, title="t", comment="cubicsplat test").encode()


def reference() -> Picture:
    return load_picture(encode(Image.fromarray(smooth_pixels(40, 28))), name="photo.png")


def judged(data: bytes = SVG, *, is_svg: bool = True, picture: Picture | None = None, **options):
    return compare_with(picture or reference(), "photo.png", data, "c", is_svg=is_svg, threads=1, **options)


def test_scale_figures_of_file_and_engine():
    found = judged(scale=3)
    assert (found.kind, found.data, found.notes) == ("svg", SVG, [])
    scale = found.scale
    assert scale.factor == 3
    assert scale.svg.native == found.quality
    own = render_scene(SCENE, threads=1)
    error = own - smooth_pixels(40, 28) / 255.0
    assert scale.engine.native.psnr_db == pytest.approx(-10 * math.log10((error**2).mean()), abs=0.02)
    for change in (scale.svg, scale.engine):
        assert change.change_db == pytest.approx(change.scaled.psnr_db - change.native.psnr_db)
        assert 0 < abs(change.change_db) < 0.1
    fields = plain(found.public())["scale"]
    assert (fields["width"], fields["height"]) == (120, 84)
    assert fields["svg"]["change_db"] == pytest.approx(scale.svg.change_db, abs=1e-3)
    assert fields["engine"]["scaled"]["psnr_db"] == pytest.approx(scale.engine.scaled.psnr_db, abs=1e-3)
    assert "NaN" not in to_json(found.public())


def test_without_a_scale_there_is_no_such_member():
    assert "scale" not in judged().public()
    assert judged().scale is None


@pytest.mark.parametrize(
    ("data", "picture", "said"),
    [
        (SVG.replace(b"</g>", b"<g/></g>"), None, "not written by cubicsplat"),
        (SVG, "large", "its size is not that of the reference"),
    ],
)
def test_files_whose_engine_figures_would_be_wrong_have_none_and_a_note(data, picture, said):
    large = load_picture(encode(Image.fromarray(smooth_pixels(80, 56)))) if picture else None
    found = judged(data, picture=large, scale=2)
    assert found.scale.engine is None
    assert plain(found.public())["scale"]["engine"] is None
    assert found.scale.svg.scaled.psnr_db > 5
    assert said in found.notes[-1]


def test_pictures_have_no_scale_and_senseless_scales_are_refused():
    data = encode(Image.fromarray(smooth_pixels(40, 28)))
    same = judged(data, is_svg=False)
    assert (same.kind, same.quality.identical, same.public()["quality"]["renderer"]) == ("raster", True, None)
    with pytest.raises(UsageError, match="scale"):
        judged(data, is_svg=False, scale=2)
    with pytest.raises(UsageError, match="from 1 to 12"):
        judged(scale=13)


def test_notes_say_what_happened_to_either_picture():
    frames = [Image.fromarray(smooth_pixels(40, 28)), Image.fromarray(smooth_pixels(40, 28) // 2)]
    animated = encode(frames[0], "GIF", save_all=True, append_images=frames[1:])
    found = judged(animated, is_svg=False, picture=load_picture(animated, name="a.gif"))
    assert [note.split(":")[0] for note in found.notes] == ["a.gif", "c"]
    wide = b'<svg xmlns="http://www.w3.org/2000/svg" width="40" height="10"/>'
    assert "shape" in judged(wide).notes[0]


# --- folders -----------------------------------------------------------------------------------------------


def make(folder: Path, *names: str) -> Path:
    folder.mkdir()
    for name in names:
        (folder / name).write_bytes(b"x")
    return folder


def names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


def test_files_are_matched_by_stem_and_the_svg_comes_first(tmp_path):
    references = make(tmp_path / "r", "a.PNG", "b.jpg", "c.webp", "d.png", "notes.txt", ".hidden")
    candidates = make(tmp_path / "c", "a.svg", "a.png", "a.json", "b.png", "d.SVG", "d.rendered.png", "other.svg")
    pairs, missing, extra = match_folders(references, candidates)
    assert [(first.name, second.name) for first, second in pairs] == [
        ("a.PNG", "a.svg"), ("b.jpg", "b.png"), ("d.png", "d.SVG"),
    ]  # fmt: skip
    assert names(missing) == ["c.webp"]
    assert sorted(names(extra)) == ["d.rendered.png", "other.svg"]
    assert names(pictures_in(references)) == ["a.PNG", "b.jpg", "c.webp", "d.png"]


def test_compressed_svgs_come_before_their_pictures_and_our_drawings_are_no_inputs(tmp_path):
    references = make(tmp_path / "r", "a.png", "b.dib")
    (references / "a.rendered.png").write_bytes(encode_png(np.zeros((4, 4, 4), np.uint8)))
    candidates = make(tmp_path / "c", "a.svgz", "a.png", "b.svg")
    pairs, *_ = match_folders(references, candidates)
    assert [(first.name, second.name) for first, second in pairs] == [("a.png", "a.svgz"), ("b.dib", "b.svg")]
    assert names(pictures_in(references)) == ["a.png", "b.dib"]


def test_folders_that_cannot_be_matched_are_refused(tmp_path):
    references = make(tmp_path / "r", "a.png")
    with pytest.raises(InputError, match="two folders"):
        match_folders(references, tmp_path / "r" / ".." / "r")
    with pytest.raises(InputError, match="no file in"):
        match_folders(references, make(tmp_path / "c", "b.svg"))
    with pytest.raises(InputError, match="same stem"):
        match_folders(make(tmp_path / "twice", "a.png", "a.jpg"), references)
    with pytest.raises(InputError, match="no pictures"):
        match_folders(make(tmp_path / "none", "a.txt"), references)
    with pytest.raises(InputError, match="cannot be read"):
        match_folders(references, tmp_path / "missing")


# --- tables ------------------------------------------------------------------------------------------------


def test_csv_is_read_back_as_it_was_meant():
    rows = [{"name": 'a, "b"', "value": 1 / 3, "on": True, "none": None, "count": 3}]
    text = csv_text(rows)
    assert text.endswith("\n")
    assert list(csv.DictReader(io.StringIO(text))) == [
        {"name": 'a, "b"', "value": "0.333333", "on": "true", "none": "", "count": "3"}
    ]
    assert csv_text([]) == ""
    assert csv_text([{"v": 30.0}, {"v": np.float64(0.5)}]) == "v\n30\n0.5\n"


def test_tables_line_up():
    table = text_table(("name", "dB"), [("a", "1.25"), ("longer", "-")])
    assert table == "name      dB\na       1.25\nlonger     -\n"
    markdown = text_table(("name", "dB"), [("a|b", "1.25")], markdown=True)
    assert markdown == "| name |   dB |\n| ---- | ---: |\n| a\\|b | 1.25 |\n"


def test_numbers_in_tables():
    assert (number(1.256, 2), number(1.256, 1, sign=True), number(None, 3)) == ("1.26", "+1.3", "-")
