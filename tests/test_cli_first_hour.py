"""What a new user runs into in the first hour: nothing made is lost, and every mistake is one clear line."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from cli_runs import SHORT, save_pictures, strict_json
from command import cli_command
from conftest import smooth_pixels
from PIL import Image
from warm import run_warm

from cubicsplat_cli.files.names import outputs_beside
from cubicsplat_cli.jobs.plan import Job
from cubicsplat_cli.jobs.results import FileSink
from cubicsplat_cli.jobs.run import DONE, FAILED, INTERRUPTED, attempt
from cubicsplat_cli.pipeline import vectorize as stages
from cubicsplat_cli.progress import Observer, Progress
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings

REQUEST = Request(FitSettings(curves=8, steps=2000, threads=1), style="photo")


def job_of(photo: Path) -> Job:
    return Job(str(photo), photo, outputs_beside(photo.with_suffix(".svg"), png=True, source=photo))


# --- nothing is lost ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("suffix", "edit"), [(".svg", "<!-- mine --></svg>"), (".svg", "</svg><!-- mine -->"), (".rendered.png", "")]
)
def test_a_file_that_was_edited_is_kept(suffix, edit, photo, run_cli):
    run_cli("vectorize", photo, *SHORT)
    edited = photo.with_name(f"photo{suffix}")
    if suffix == ".svg":
        edited.write_text(edited.read_text().replace("</svg>", edit))
    else:
        with Image.open(edited) as image:
            text = image.text if hasattr(image, "text") else {}
            pixels = np.asarray(image.convert("RGB")).copy()
        pixels[0, 0] ^= 255
        from PIL.PngImagePlugin import PngInfo

        info = PngInfo()
        for name, value in text.items():
            info.add_text(name, value)
        Image.fromarray(pixels).save(edited, pnginfo=info)
    before = edited.read_bytes()
    said = "was edited since it was made; --force replaces it"
    for arguments in ([], ["--seed", 9]):
        run_cli("vectorize", photo, *SHORT, *arguments, code=2, error=said)
        assert edited.read_bytes() == before
    run_cli("vectorize", photo, *SHORT, "--force")
    assert edited.read_bytes() != before


@pytest.mark.parametrize(("suffix", "size"), [(".svg", 300), (".json", 0), (".json", 25)])
def test_what_a_crashed_disk_left_is_made_anew(suffix, size, photo, run_cli):
    run_cli("vectorize", photo, *SHORT)
    whole = photo.with_suffix(".svg").read_bytes()
    path = photo.with_suffix(suffix)
    path.write_bytes(path.read_bytes()[:size])
    done = run_cli("vectorize", photo, *SHORT)
    assert b"unchanged" not in done.stderr
    assert photo.with_suffix(".svg").read_bytes() == whole
    assert strict_json(photo.with_suffix(".json").read_bytes())["interrupted"] is False


@pytest.mark.parametrize("force", [[], ["--force"]])
def test_render_never_takes_a_picture_of_the_users_by_default(force, photo, run_cli):
    before = photo.read_bytes()
    run_cli("vectorize", photo, *SHORT, "--no-png")
    run_cli("render", photo.with_suffix(".svg"), *force)
    assert photo.read_bytes() == before
    assert photo.with_name("photo.rendered.png").is_file()
    run_cli("render", photo.with_suffix(".svg"), "-o", photo, code=2)
    assert photo.read_bytes() == before


class Impatient(Observer):
    """Presses Ctrl-C as soon as the fit is under way."""

    def __init__(self) -> None:
        self.notes: list[str] = []

    def step(self, progress: Progress, job: str) -> None:
        raise KeyboardInterrupt

    def note(self, text: str, job: str = "") -> None:
        self.notes.append(text)


def test_a_finished_svg_is_never_replaced_by_an_interrupted_one(photo):
    job = job_of(photo)
    first = attempt(job, REQUEST.with_threads(1), sink=FileSink(job), observer=Impatient())
    assert first.status == INTERRUPTED
    assert strict_json(job.outputs.metrics.read_bytes())["interrupted"] is True
    quick = Request(FitSettings(curves=8, steps=20, threads=1), style="photo")
    assert attempt(job, quick, sink=FileSink(job), observer=Observer()).status == DONE
    finished = job.outputs.svg.read_bytes()
    impatient = Impatient()
    again = attempt(job, REQUEST, sink=FileSink(job), observer=impatient)
    assert (again.status, again.report) == (INTERRUPTED, None)
    assert job.outputs.svg.read_bytes() == finished
    assert "as the earlier, finished run left it" in impatient.notes[-1]


@pytest.mark.parametrize(
    ("error", "status", "said"), [(MemoryError, FAILED, "memory"), (KeyboardInterrupt, INTERRUPTED, "")]
)
def test_what_is_written_is_named_when_measuring_fails(error, status, said, photo, monkeypatch):
    def fail(*_: object) -> None:
        raise error

    monkeypatch.setattr(stages, "measured", fail)
    job, observer = job_of(photo), Impatient()
    observer.step = lambda *_: None
    short = Request(FitSettings(curves=8, steps=20, threads=1), style="photo")
    outcome = attempt(job, short, sink=FileSink(job), observer=observer)
    assert outcome.status == status
    words = outcome.error or observer.notes[-1]
    assert said in words
    assert str(job.outputs.svg) in words
    assert job.outputs.svg.read_bytes().rstrip().endswith(b"</svg>")


@pytest.mark.parametrize("arguments", [[], ["bench"]])
def test_a_command_alone_shows_its_help(arguments, run_cli):
    done = run_cli(*arguments)
    assert done.stderr == b""
    assert done.stdout == run_cli(*arguments, "--help").stdout
    assert done.stdout.count(b"\n") > 8


def test_a_background_that_was_asked_for_lies_under_a_transparent_picture(tmp_path, run_cli):
    badge = tmp_path / "badge.png"
    image = Image.new("RGBA", (40, 30), (0, 0, 0, 0))
    image.paste((200, 40, 40, 255), (10, 5, 30, 25))
    image.save(badge)
    for style, few in (("artwork", []), ("photo", ["--curves", 6, "--steps", 30, "--threads", 1])):
        done = run_cli("vectorize", badge, "--background", "white", "--style", style, "--json", "--force", *few)
        with Image.open(tmp_path / "badge.rendered.png") as drawn:
            assert drawn.mode == "RGB"
            assert drawn.getpixel((0, 0))[1] > 230
        found = strict_json(done.stdout)
        assert found["input"]["alpha"] is True
        assert found["quality"]["svg"]["psnr_db"] is None or found["quality"]["svg"]["psnr_db"] > 20


# --- words -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["vectorize", "x.png", "--curves", "0"], "--curves must be a whole number from 1 to 1000000, or auto, not 0"),
        (["vectorize", "x.png", "--curves", "many"], "--curves must be a whole number from 1 to 1000000, or auto, not"),
        (["vectorize", "x.png", "--segments", "17"], "--segments must be a whole number from 1 to 16, not 17"),
        (["vectorize", "x.png", "--threads", "0"], "--threads must be a whole number from 1 to 1024, not 0"),
        (["vectorize", "x.png", "--seed", "-1"], "--seed must be a whole number from 0 to "),
        (["vectorize", "x.png", "--precision", "7"], "--precision must be a whole number from 0 to 6, not 7"),
        (["vectorize", "x.png", "--max-pixels", "0"], "--max-pixels must be a whole number of at least 1, not 0"),
        (["vectorize", "-", "-o", "-", "--json"], "--json and the SVG would both go to standard output"),
        (["vectorize", "x.png", "--steps", "many"], "--steps must be a whole number, not 'many'"),
        (["vectorize", "x.png", "--preset", "hihg"], "--preset must be draft, standard, high or paper, not 'hihg'\n"),
        (
            ["vectorize", "x.png", "--background", "wite"],
            "--background must be auto, none, a colour name or #rrggbb, n",
        ),
        (["vectorize", "x.png", "--colors", "4", "--style", "photo"], "--colors is for artwork, not for photos; leave"),
        (
            ["vectorize", "x.png", "--colors", "4", "--loss", "l1"],
            "--colors is for artwork, --loss for photo",
        ),
        (["vectorize", "x.png", "--time-limit", "soon"], "--time-limit must be a number, not 'soon'"),
        (["vectorize", "x.png", "--time-limit", "-1"], "--time-limit must be a number from"),
        (["vectorize", "x.png", "--mode", "round"], "--mode must be closed or open, not 'round'"),
        (["vectorize", "x.png", "--palette", "red,nocolour"], "--palette must be colours"),
        (["vectorize", "x.png", "--colour"], "there is no option --colour; did you mean --colors"),
        (["vectorise", "x.png"], "there is no command 'vectorise'; did you mean vectorize?"),
        (["vectorize"], "IN... is missing"),
        (["vectorize", "x.png", "--xyzzy"], "there is no option --xyzzy; see --help"),
        (["vectorize", "x.png", "--curves"], "--curves needs a value; see --help"),
        (["doctor", "twice"], "there is nothing that 'twice' could be for; see --help"),
        (["bench", "bogus"], "there is no command 'bogus'; the commands are step, "),
        (["help", "it's"], 'there is no command "it\'s"; the commands are vectorize, animate, eval, '),
        (["vectorize", "a.png", "-o", "x"], "the output must end in .svg, but -o is x; -o x.svg is a file, -o x/ a"),
        (
            ["vectorize", "a.png", "--svgz", "-o", "x.svg"],
            "the output must end in .svgz, but -o is x.svg; call it x.svgz",
        ),
        (["vectorize", "a.png", "-o", "x.cdr"], "the output must end in .svg, but -o is x.cdr; call it x.svg"),
        (["vectorize", "a.png", "b.png", "-o", "out.svg"], "-o out.svg is for one picture that you name; give a f"),
        (["vectorize", "x.png", "--device", "gpu"], "--device must be auto, cpu or cuda, not 'gpu'\n"),
    ],
)
def test_mistakes_are_one_line_in_one_style(arguments, said, run_cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_cli(*arguments, code=2, error=f"cubicsplat: error: {said}")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("arguments", [["--curves", "8", "--steps", "9", "pictures", "-q"], ["pictures", *SHORT]])
def test_a_folder_and_options_need_no_command(arguments, photo, run_cli, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "pictures").mkdir()
    photo.rename(tmp_path / "pictures" / "photo.png")
    run_cli(*arguments)
    assert (tmp_path / "pictures" / "photo.svg").exists()


def test_a_gpu_that_is_asked_for_and_missing_fails_also_for_drawings(run_cli, tmp_path, monkeypatch):
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "")
    Image.new("RGB", (32, 32), "red").save(tmp_path / "flat.png")
    run_cli("vectorize", tmp_path / "flat.png", "--device", "cuda", code=1, error="use --device cpu")
    assert not (tmp_path / "flat.svg").exists()


def test_a_web_address_is_no_file_and_makes_no_folder(tmp_path, run_cli, monkeypatch):
    monkeypatch.chdir(tmp_path)
    run_cli("vectorize", "https://example.org/a.png", code=1, error="no such file; download it first")
    assert not list(tmp_path.iterdir())


def test_what_is_in_the_way_of_an_output_is_said(photo, tmp_path, run_cli):
    (tmp_path / "a").write_text("x")
    (tmp_path / "folder.svg").mkdir()
    said = "a: is a file, but x.svg needs a folder; choose another with -o\n"
    run_cli("vectorize", photo, "-o", tmp_path / "a" / "x.svg", code=1, error=said)
    run_cli("render", photo, code=1, error="photo.png: is no SVG; give an SVG file\n")
    run_cli("render", tmp_path, code=1, error="is a folder without SVGs")


def test_a_picture_in_place_of_a_command_and_choices_in_any_case(photo, run_cli):
    run_cli(photo, "--style", "PHOTO", "--mode", "Open", *SHORT[2:], "--background", "transparent")
    found = strict_json(photo.with_suffix(".json").read_bytes())["settings"]
    assert (found["mode"], found["background"]) == ("open", "none")
    assert not re.search(rb"None|False", run_cli(photo, "--curves", "Auto", "--style", "artwork", "-v").stderr)
    assert run_cli("-", *SHORT, data=photo.read_bytes()).stdout.rstrip().endswith(b"</svg>")
    assert b"vectorize" in run_cli("help").stdout
    assert b"--scale" in run_cli("help", "eval").stdout


def test_what_is_left_out_of_a_folder_is_counted_and_named(tmp_path, run_cli):
    Image.fromarray(smooth_pixels(20, 16)).save(tmp_path / "a.png")
    (tmp_path / "b.heic").write_bytes(b"x")
    (tmp_path / "notes.txt").write_text("x")
    done = run_cli("vectorize", tmp_path, "-o", tmp_path / "out", *SHORT)
    assert b"left out, not a picture by its name: 1 (" in done.stderr
    assert b"left out, HEIC, which pip install pillow-heif has read: 1 (" in done.stderr
    assert b"1 picture in" not in done.stderr, "a table of one picture says nothing"


def test_links_to_folders_are_not_followed_by_patterns_either(tmp_path, run_cli):
    save_pictures(tmp_path / "real", ["a.png"])
    (tmp_path / "link").symlink_to(tmp_path / "real", target_is_directory=True)
    done = run_cli("vectorize", str(tmp_path / "**" / "*.png"), "-o", tmp_path / "out", "--dry-run", *SHORT)
    assert done.stdout.count(b"to do") == 1


def test_a_pattern_ends_where_links_lead_back_to_their_own_folder(tmp_path, run_cli):
    save_pictures(tmp_path / "real", ["a.png"])
    for name in ("one", "two"):
        (tmp_path / "real" / name).symlink_to(tmp_path, target_is_directory=True)
    (tmp_path / "named").symlink_to(tmp_path / "real", target_is_directory=True)
    for pattern in ("**/*.png", "**/**/*.png", "**/*/a.png", "real/**", "named/**/*.png"):
        done = run_cli("vectorize", str(tmp_path / pattern), "-o", tmp_path / "out", "--dry-run", *SHORT)
        assert done.stdout.count(b"to do") == 1, pattern


def test_an_empty_picture_in_a_folder_fails_as_it_does_alone(tmp_path, run_cli):
    (tmp_path / "a.png").write_bytes(b"")
    for source in (tmp_path, tmp_path / "*.png", tmp_path / "a.png"):
        said = "a.png: is empty (0 bytes); give a picture\n"
        run_cli("vectorize", source, "-o", tmp_path / "out/", *SHORT, code=1, error=said)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="no endless file on this system")
@pytest.mark.parametrize("arguments", [["-"], ["vectorize", "-"], ["render", "-"], ["eval", "PHOTO", "-"]])
def test_endless_standard_input_is_one_line(arguments, photo, run_cli, monkeypatch):
    monkeypatch.setattr("cubicsplat_cli.files.read.MAX_SVG_BYTES", 1 << 20)
    arguments = [str(photo) if word == "PHOTO" else word for word in arguments]
    if "render" not in arguments:
        arguments += ["--max-pixels", "70000"]
    limit = "1 MiB, the limit" if "render" in arguments else "2 MiB, what --max-pixels 70000 needs"
    with Path("/dev/zero").open("rb") as zeros:
        said = f"cubicsplat: error: stdin: is larger than {limit}; give a smaller file\n"
        run_cli(*arguments, stdin=zeros, code=1, error=said)


def test_a_completion_that_cannot_be_installed_is_one_line(tmp_path, run_cli, monkeypatch):
    monkeypatch.setattr("shellingham.detect_shell", lambda: ("bash", "/bin/bash"))  # whatever runs the tests
    (tmp_path / "file").write_bytes(b"")
    (tmp_path / ".bashrc").write_bytes(b"# caf\xe9\n")
    for home, said in ((tmp_path / "file", "/file cannot be written ("), (tmp_path, "is not UTF-8")):
        monkeypatch.setenv("HOME", str(home))
        done = run_cli("--install-completion", "bash", code=1)
        assert re.fullmatch(rf"cubicsplat: error: --install-completion: .*{re.escape(said)}.*\n", done.stderr.decode())


def test_no_measure_writes_the_svg_and_says_so(photo, run_cli):
    done = run_cli("vectorize", photo, *SHORT, "--no-measure")
    assert b"not measured" in done.stderr
    assert sorted(path.name for path in photo.parent.iterdir()) == ["photo.json", "photo.png", "photo.svg"]
    assert strict_json(photo.with_suffix(".json").read_bytes())["quality"] is None


def test_a_time_limit_that_cannot_be_met_is_told(photo, run_cli):
    done = run_cli("vectorize", photo, "--style", "photo", "--curves", 12, "--time-limit", 0.001)
    assert re.search(rb"took [\d.]+ s, more than --time-limit 0.001: [\d.]+ s for the fit, [\d.]+ s for", done.stderr)


def test_a_dry_run_tells_of_a_page_that_is_missing(photo, run_cli):
    run_cli("vectorize", photo, *SHORT)
    done = run_cli("vectorize", photo, *SHORT, "--report", "--dry-run")
    assert done.stdout == f"to do  {photo} -> {photo.with_suffix('.html')}\n".encode()
    planned = strict_json(run_cli("vectorize", photo, *SHORT, "--report", "--dry-run", "--json").stdout)
    assert planned["status"] == "planned"
    assert "quality" not in planned
    run_cli("vectorize", photo, *SHORT, "--report")
    done = run_cli("vectorize", photo, *SHORT, "--report", "--dry-run")
    assert done.stdout == f"unchanged  {photo} -> {photo.with_suffix('.svg')}\n".encode()


def test_nothing_does_not_move(tmp_path, run_cli):
    Image.new("RGBA", (30, 20), (0, 0, 0, 0)).save(tmp_path / "nothing.png")
    done = run_cli("vectorize", tmp_path / "nothing.png", "--animation", tmp_path / "a.webp")
    assert b"is transparent throughout, so there is no animation" in done.stderr
    assert not (tmp_path / "a.webp").exists()


@pytest.mark.parametrize(("noise", "curves"), [(1, False), (12, True)])
def test_the_noise_of_a_jpeg_of_one_colour_is_not_drawn(noise, curves, tmp_path, run_cli):
    pixels = np.random.default_rng(0).integers(0, noise + 1, (60, 90, 1)) + np.array([200, 40, 40])
    Image.fromarray(pixels.astype(np.uint8)).save(tmp_path / "red.jpg", quality=90)
    with Image.open(tmp_path / "red.jpg") as image:
        assert np.ptp(np.asarray(image).astype(int).reshape(-1, 3), axis=0).max() > 0
    run_cli("vectorize", tmp_path / "red.jpg", *SHORT, "--svg-only")
    text = (tmp_path / "red.svg").read_text()
    assert ("<path" in text) is curves
    assert curves or 'fill="#c82828"' in text or 'fill="#c92929"' in text


# --- streams -----------------------------------------------------------------------------------------------


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no /dev/full on this system")
@pytest.mark.parametrize(
    "arguments",
    [["--help"], ["--version"], ["vectorize", "--help"], ["vectorize", "PHOTO", *SHORT, "-o", "-"],
     ["vectorize", "PHOTO", "--dry-run", "--json"], pytest.param(["doctor"], marks=pytest.mark.slow)],
    ids=lambda arguments: arguments[-1],
)  # fmt: skip
def test_a_full_disk_behind_the_output_is_one_line(arguments, photo):
    """To the end of the process, where Python flushes once more; but some would take seconds to start."""
    arguments = [str(photo) if word == "PHOTO" else word for word in arguments]
    with Path("/dev/full").open("wb") as full:
        if arguments[0] in ("doctor", "vectorize"):
            done = run_warm(*arguments, stdout=full.fileno())
        else:
            done = subprocess.run(
                [*cli_command(), *arguments], stdout=full, stderr=subprocess.PIPE, check=False, timeout=200
            )
    assert done.returncode == 1
    assert b"Traceback" not in done.stderr
    assert done.stderr.decode().splitlines()[-1].startswith("cubicsplat: error: standard output: cannot be written")


@pytest.mark.skipif(sys.platform == "win32", reason="descriptors of POSIX")
@pytest.mark.parametrize("closed", [0, 1, 2])
def test_closed_streams_do_no_harm(closed):
    done = subprocess.run(
        [*cli_command(), "--help"], capture_output=True, check=False, timeout=200, preexec_fn=lambda: os.close(closed)
    )
    assert done.returncode == 0
    assert b"Traceback" not in done.stderr
