"""Which files a run writes, under which names, and which it leaves alone."""

from __future__ import annotations

from pathlib import Path

import pytest
from cli_runs import SHORT, json_lines, save_pictures, strict_json
from conftest import rest_slow, smooth_pixels
from PIL import Image

from cubicsplat_cli.files.read import packed, read_file

QUICK = (*SHORT, "--no-measure")


def names(folder: Path) -> set[str]:
    return {path.name for path in folder.iterdir()}


def ended(done) -> dict[str, str]:
    """How each picture ended."""
    return {name: line["status"] for name, line in json_lines(done.stdout).items()}


def test_a_second_picture_of_the_same_stem_leaves_the_first_one_its_files(tmp_path, run_cli):
    save_pictures(tmp_path, ["a.jpg", "b & c.png"])
    run_cli("vectorize", tmp_path, *QUICK)
    save_pictures(tmp_path, ["a.png", "b & c.bmp", "d.jpg", "d.png"])
    Image.fromarray(smooth_pixels(30, 22)).save(tmp_path / "a.png")
    before = {name: (tmp_path / name).read_bytes() for name in ("a.svg", "b & c.svg")}
    done = run_cli("vectorize", tmp_path, *QUICK, "--json")
    assert ended(done) == {
        "a.jpg": "unchanged", "b & c.png": "unchanged",
        "a.png": "done", "b & c.bmp": "done", "d.jpg": "done", "d.png": "done",
    }  # fmt: skip
    drawn = {name for name in names(tmp_path) if name.endswith(".svg")}
    assert drawn == {"a.svg", "a.png.svg", "b & c.svg", "b & c.bmp.svg", "d.jpg.svg", "d.png.svg"}
    assert all((tmp_path / name).read_bytes() == data for name, data in before.items())
    assert set(ended(run_cli("vectorize", tmp_path, *QUICK, "--json")).values()) == {"unchanged"}


def test_so_does_one_that_is_vectorised_alone(tmp_path, run_cli):
    save_pictures(tmp_path, ["a.jpg", "a.png"])
    run_cli("vectorize", tmp_path / "a.jpg", *QUICK)
    first = (tmp_path / "a.svg").read_bytes()
    for output in ([], ["-o", f"{tmp_path}/"]):
        run_cli("vectorize", tmp_path / "a.png", *QUICK, *output)
    assert {name for name in names(tmp_path) if name.endswith(".svg")} == {"a.svg", "a.png.svg"}
    assert (tmp_path / "a.svg").read_bytes() == first
    (tmp_path / "a.jpg").unlink()
    (tmp_path / "a.png.svg").unlink()
    run_cli("vectorize", tmp_path / "a.png", *QUICK)
    assert (tmp_path / "a.svg").read_bytes() != first, "nobody's any more"


def test_svg_only_and_no_json(photo, run_cli):
    run_cli("vectorize", photo, *SHORT, "--no-json")
    assert names(photo.parent) == {"photo.png", "photo.svg", "photo.rendered.png"}
    (photo.parent / "photo.rendered.png").unlink()
    (photo.parent / "photo.svg").unlink()
    run_cli("vectorize", photo, *QUICK, "--svg-only")
    assert names(photo.parent) == {"photo.png", "photo.svg"}


@pytest.mark.parametrize(
    "options",
    rest_slow((("--svg-only", "--svgz"),), ((),), (("--svg-only",),), (("--style", "artwork", "--no-json"),), fast=2),
)
def test_without_a_json_the_svg_itself_tells_whether_it_was_edited(options, photo, run_cli):
    svg = photo.with_suffix(".svgz" if "--svgz" in options else ".svg")
    arguments = ["vectorize", photo, *QUICK, *options]
    run_cli(*arguments)
    photo.with_suffix(".json").unlink(missing_ok=True)
    made = read_file(svg)
    run_cli(*arguments, "--seed", 2)  # nobody has edited it
    assert read_file(svg) != made
    photo.with_suffix(".json").unlink(missing_ok=True)
    edited = read_file(svg).replace(b"</svg>", b"<!-- mine --></svg>")
    svg.write_bytes(packed(edited.decode(), compressed=svg.suffix == ".svgz"))
    for more in ([], ["--seed", 2]):
        run_cli(*arguments, *more, code=2, error="was edited since it was made; --force replaces it")
    run_cli(*arguments, "--skip-existing")
    assert read_file(svg) == edited
    run_cli(*arguments, "--force")
    assert b"mine" not in read_file(svg)


def test_without_json_an_earlier_one_is_used_and_does_not_outlive_its_svg(photo, run_cli):
    run_cli("vectorize", photo, *QUICK)
    done = run_cli("vectorize", photo, *QUICK, "--svg-only")
    assert b"unchanged" in done.stderr
    run_cli("vectorize", photo, *QUICK, "--svg-only", "--seed", 2)
    assert names(photo.parent) == {"photo.png", "photo.svg"}


def test_existing_svgs_are_skipped_whatever_made_them(tmp_path, run_cli):
    save_pictures(tmp_path, ["a.png", "b.png", "c.png"])
    run_cli("vectorize", tmp_path / "a.png", *QUICK)
    (tmp_path / "b.svg").write_text("<svg>by hand</svg>")
    (tmp_path / "c.svg").touch()
    done = run_cli("vectorize", tmp_path, *QUICK, "--skip-existing", "--seed", 5, "--json")
    assert ended(done) == {"a.png": "unchanged", "b.png": "unchanged", "c.png": "done"}
    assert strict_json((tmp_path / "a.json").read_bytes())["settings"]["seed"] == 0
    assert (tmp_path / "b.svg").read_text() == "<svg>by hand</svg>"
    assert b"b.svg  unchanged" in done.stderr


def test_a_suffix_of_the_names(photo, tmp_path, run_cli):
    run_cli("vectorize", photo, *QUICK, "--suffix", "-small", "--svgz")
    assert names(tmp_path) == {"photo.png", "photo-small.svgz", "photo-small.json"}
    run_cli("vectorize", photo, *QUICK, "--suffix", ".min", "-o", f"{tmp_path}/out/", "--svg-only")
    assert names(tmp_path / "out") == {"photo.min.svg"}
    run_cli("vectorize", tmp_path, *QUICK, "--suffix", "-2", "-o", tmp_path / "many")
    assert names(tmp_path / "many") == {"photo-2.svg", "photo-2.json"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--suffix", "/x"], "--suffix must be the end of a file's name"),
        (["--suffix", "-x", "-o", "y.svg"], "--suffix is of names made of the picture's"),
        (["--force", "--skip-existing"], "give one of them"),
    ],
)
def test_wrong_usage(arguments, said, photo, run_cli):
    run_cli("vectorize", photo, *QUICK, *arguments, code=2, error=said)
    assert names(photo.parent) == {"photo.png"}
