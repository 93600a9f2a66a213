"""Where results go and what may be overwritten; the words of the summary and the progress."""

from __future__ import annotations

import gzip
import os
import sys
from pathlib import Path

import numpy as np
import pytest

from cubicsplat_cli.cli.console import Reporter, progress_text
from cubicsplat_cli.errors import CubicSplatError, InputError, UsageError
from cubicsplat_cli.files.marks import provenance_comment, settings_hash
from cubicsplat_cli.files.names import is_compressed_name, plan_outputs
from cubicsplat_cli.files.paths import check_outputs, check_ownership, is_ours
from cubicsplat_cli.files.write import encode_png
from cubicsplat_cli.formatting import duration, file_size
from cubicsplat_cli.metrics import to_json
from cubicsplat_cli.options import parse_background
from cubicsplat_cli.progress import Progress
from cubicsplat_cli.request import Request


def names(outputs) -> list[str]:
    return [path.name for path in outputs.files()]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    for name in ("photo.png", "photo.jpg"):
        (tmp_path / name).write_bytes(b"somebody's picture")
    return tmp_path


def test_default_is_beside_the_input(folder):
    outputs = plan_outputs(folder / "other.jpg", None, Request())
    assert [path.parent for path in outputs.files()] == [folder] * 3
    assert names(outputs) == ["other.svg", "other.png", "other.json"]
    assert names(plan_outputs(folder / "photo.jpg", None, Request(png=False))) == ["photo.svg", "photo.json"]


def test_rendered_picture_never_takes_the_name_of_somebodys_picture(folder):
    for source in ("photo.png", "photo.jpg"):
        assert names(plan_outputs(folder / source, None, Request()))[1] == "photo.rendered.png"
    (folder / "photo.png").write_bytes(encode_png(np.zeros((4, 4, 4), np.uint8)))
    assert names(plan_outputs(folder / "photo.jpg", None, Request()))[1] == "photo.png", "drawn by us"
    (folder / "photo.png").write_bytes(b"somebody's picture")
    link = folder / "link.png"
    link.symlink_to(folder / "photo.png")
    assert names(plan_outputs(folder / "photo.png", str(folder / "link.svg"), Request()))[1] == "link.rendered.png"


def test_output_may_be_a_folder_or_another_name(folder):
    (folder / "out").mkdir()
    assert plan_outputs(folder / "photo.png", str(folder / "out"), Request()).svg == folder / "out" / "photo.svg"
    assert plan_outputs(None, str(folder / "out"), Request()).svg == folder / "out" / "stdin.svg"
    assert names(plan_outputs(folder / "photo.png", str(folder / "b.SVG"), Request())) == ["b.SVG", "b.png", "b.json"]
    assert plan_outputs(folder / "photo.png", f"{folder}/new/", Request()).svg == folder / "new" / "photo.svg"


def test_compressed_outputs(folder):
    jpeg = folder / "photo.jpg"
    assert names(plan_outputs(jpeg, None, Request(png=False, compress=True))) == ["photo.svgz", "photo.json"]
    assert names(plan_outputs(jpeg, str(folder / "x.svgz"), Request(png=False))) == ["x.svgz", "x.json"]
    assert is_compressed_name(plan_outputs(jpeg, str(folder / "x.svgz"), Request(png=False)).svg)
    with pytest.raises(UsageError, match=r"\.svgz"):
        plan_outputs(jpeg, str(folder / "x.svg"), Request(png=False, compress=True))


def test_standard_output_writes_no_files(folder):
    assert plan_outputs(folder / "photo.png", "-", Request()).files() == []
    assert plan_outputs(None, None, Request()).files() == []


def test_wrong_endings_and_the_input_itself_are_refused(folder):
    with pytest.raises(UsageError, match=r"\.svg"):
        plan_outputs(folder / "photo.jpg", str(folder / "x.png"), Request())
    odd = folder / "odd.svg"
    odd.write_bytes(b"a picture with a wrong name")
    with pytest.raises(UsageError, match="is the input"):
        plan_outputs(odd, None, Request())
    with pytest.raises(UsageError, match="is the input"):
        plan_outputs(odd, str(folder / "." / "odd.svg"), Request())


def test_files_of_others_are_not_replaced_without_force(folder):
    paths = [folder / "new.svg", folder / "photo.png"]
    with pytest.raises(UsageError, match=r"photo\.png exists.*--force"):
        check_outputs(paths, force=False)
    check_outputs(paths, force=True)
    assert (folder / "photo.png").read_bytes() == b"somebody's picture"
    assert not (folder / "new.svg").exists()


def test_our_files_are_known_by_their_marks(folder):
    from scenes import random_scene

    from cubicsplat_cli.settings import Mode
    from cubicsplat_cli.svg.scene_writer import write_svg

    comment = provenance_comment(4, settings_hash({"a": 1}), "ab" * 32)
    ours = {
        "a.svg": write_svg(random_scene(Mode.CLOSED), title="t" * 9000, comment=comment).encode(),
        "a.svgz": gzip.compress(write_svg(random_scene(Mode.CLOSED), title="t", comment=comment).encode()),
        "a.png": encode_png(np.zeros((4, 4, 4), np.uint8)),
        "a.json": to_json({"schema": 1, "program": "cubicsplat"}).encode(),
    }
    for name, data in ours.items():
        (folder / name).write_bytes(data)
        assert is_ours(folder / name), name
        packed = name == "a.svgz"
        foreign = (gzip.decompress(data) if packed else data).replace(b"cubicsplat", b"inkscape  ")
        (folder / name).write_bytes(gzip.compress(foreign) if packed else foreign)
        assert not is_ours(folder / name), name
        (folder / name).write_bytes(data[:20])
        assert is_ours(folder / name) is (name == "a.json"), "a report that was cut short is nobody else's"
        (folder / name).write_bytes(b"")
        assert not is_ours(folder / name)
        check_ownership([folder / name], force=False)  # a crashed disk leaves files without a byte


def test_impossible_outputs_are_found_before_the_work(folder):
    with pytest.raises(InputError, match="does not exist"):
        check_outputs([folder / "missing" / "a.svg"], force=True)
    if hasattr(os, "mkfifo"):
        os.mkfifo(folder / "pipe.svg")
        with pytest.raises(InputError, match="pipe"):
            check_outputs([folder / "pipe.svg"], force=False)


def test_settings_hash_depends_on_values_not_on_order():
    first = settings_hash({"a": 1, "b": [1, 2]})
    assert first == settings_hash({"b": [1, 2], "a": 1})
    assert first != settings_hash({"a": 2, "b": [1, 2]})
    assert len(first) == 12


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("auto", "auto"),
        ("NONE", "none"),
        ("transparent", "none"),
        ("#FfCc00", "#ffcc00"),
        ("#fc0", "#ffcc00"),
        ("teal", "#008080"),
    ],
)
def test_backgrounds(text, value):
    assert parse_background(text) == value


@pytest.mark.parametrize("text", ["", "#12", "#12345678", "ffcc00", "not a colour", "rgba(1,2,3,4)"])
def test_bad_backgrounds_are_usage_errors(text):
    with pytest.raises(UsageError, match="background"):
        parse_background(text)


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0.04, "0.0 s"),
        (0.84, "0.8 s"),
        (47.2, "47 s"),
        (125, "2 min 05 s"),
        (3780, "1 h 03 min"),
        (3599.9, "1 h 00 min"),
    ],
)
def test_durations(seconds, text):
    assert duration(seconds) == text


@pytest.mark.parametrize(
    ("count", "text"), [(612, "612 B"), (1234, "1.2 kB"), (61_400, "61 kB"), (999_600, "1.0 MB"), (6_400_000, "6.4 MB")]
)
def test_file_sizes(count, text):
    assert file_size(count) == text


def progress(step: int) -> Progress:
    return Progress(step / 100, step, 100, psnr_db=28.314, ms_per_step=14.23, replaced=320, seconds_left=23.4)


def test_progress_begins_with_what_matters_and_is_cut_to_the_room():
    assert progress_text(progress(1)) == "  1 %  23 s left  28.3 dB  14.2 ms/step  320 replaced"
    assert progress_text(progress(1), 26) == "  1 %  23 s left  28.3 dB"
    assert progress_text(progress(100), 3) == "100 %"


def test_plain_progress_is_a_few_lines_and_goes_to_stderr(capsys):
    with Reporter(quiet=False, verbose=True).progress("x") as show:
        for step in range(1, 101):
            show(progress(step))
    out, err = capsys.readouterr()
    assert out == ""
    assert 9 <= len(err.splitlines()) <= 13
    assert "100/100" in err.splitlines()[-1]


@pytest.mark.parametrize(("quiet", "verbose"), [(True, False), (True, True), (False, False)])
def test_no_progress_where_none_was_asked_for(quiet, verbose, capsys):
    assert not sys.stderr.isatty()
    with Reporter(quiet=quiet, verbose=verbose).progress("x") as show:
        for step in range(1, 101):
            show(progress(step))
    assert capsys.readouterr().err == ""


def test_messages_stay_one_line(capsys):
    reporter = Reporter(quiet=False, verbose=False)
    reporter.note("a\nb\x1b[31m")
    reporter.detail("hidden")
    assert capsys.readouterr().err == "cubicsplat: note: a\\nb\\x1b[31m\n"


def test_png_is_rgb_only_when_opaque():
    from io import BytesIO

    from PIL import Image

    pixels = np.random.default_rng(0).integers(0, 256, (5, 7, 4), dtype=np.uint8)
    with Image.open(BytesIO(encode_png(pixels))) as image:
        assert image.mode == "RGBA"
        assert (np.asarray(image) == pixels).all()
    pixels[..., 3] = 255
    with Image.open(BytesIO(encode_png(pixels))) as image:
        assert image.mode == "RGB"
        assert (np.asarray(image) == pixels[..., :3]).all()


def test_every_error_of_ours_has_an_exit_code():
    assert {error.exit_code for error in (CubicSplatError, InputError, UsageError)} == {1, 2}
