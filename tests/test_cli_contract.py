"""What holds for the command as a whole: fast --help, exit codes, errors, and complete documentation."""

from __future__ import annotations

import json
import os
import subprocess
import sys

import pytest
import typer
from cli_runs import asked_by
from command import cli_command, run_process
from conftest import rest_slow
from PIL import Image, ImageDraw

import cubicsplat_cli
from cubicsplat_cli import __main__
from cubicsplat_cli._version import __version__
from cubicsplat_cli.cli import app as app_module
from cubicsplat_cli.cli import doctor as doctor_module
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.request import Request

try:
    import resource
except ImportError:  # Windows
    resource = None

HEAVY = ("torch", "numpy", "skimage", "cairosvg", "resvg_py", "svgwrite", "PIL", "scipy")
# What only scans, enlargements, blurred pictures, strokes and photos need; any part of scipy takes 0.2 s to import.
RARE = ("torch", "skimage", "scipy", "svgwrite", "cubicsplat_cli.photo.loop", "cubicsplat_cli.artwork.strokes.build")
OTHERS = ("cubicsplat_cli.cli.bench", "cubicsplat_cli.cli.render", "pydantic")  # other commands and wrong options


def test_version():
    done = run_process("--version")
    assert (done.returncode, done.stdout.decode().strip()) == (0, f"cubicsplat {__version__}")
    assert cubicsplat_cli.__version__ == __version__


# Runs the command with each line of arguments, one after the other; after each, what is imported of the heavy modules.
IMPORTS = f"""
import contextlib, json, os, sys
from cubicsplat_cli.__main__ import main
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["cubicsplat", *arguments]
    with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink), contextlib.redirect_stderr(sink):
        try:
            main()
        except SystemExit as end:
            code = end.code
    print(json.dumps([code, [name for name in {sorted({*HEAVY, *RARE, *OTHERS})!r} if name in sys.modules]]))
"""
LIGHT = [
    ["--version"],
    ["--help"],
    ["vectorize", "--help"],
    ["eval", "--help"],
    ["render", "--help"],
    ["doctor", "--help"],
    ["vectorize", "x.png", "--curves", "0"],
    ["vectorize", "x.png", "--preset", "none"],
    ["vectorize", "-", "--json"],
]


def imported(*lines: list[str]) -> list[tuple[int, list[str]]]:
    """Exit code and imported heavy modules after each of these calls of the command in a process of their own."""
    command = [sys.executable, "-c", IMPORTS, json.dumps(lines)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=200)
    return [tuple(json.loads(line)) for line in done.stdout.splitlines()]


def test_help_and_wrong_usage_import_nothing_heavy_and_a_missing_picture_no_torch(tmp_path):
    *light, missing = imported(*LIGHT, ["vectorize", str(tmp_path / "none.png")])
    for arguments, (code, heavy) in zip(LIGHT, light, strict=True):
        heavy = [name for name in heavy if name not in OTHERS]
        assert (code, heavy) == (0 if arguments[-1] in ("--help", "--version") else 2, []), arguments
    assert missing[0] == 1
    assert "torch" not in missing[1]


def test_drawing_and_measuring_an_svg_import_no_torch(photo, tmp_path):
    (tmp_path / "a.svg").write_text('<svg xmlns="http://www.w3.org/2000/svg" width="40" height="28"/>')
    drawn = ["render", str(tmp_path / "a.svg"), "-o", str(tmp_path / "a.png")]
    for code, heavy in imported(drawn, ["eval", str(photo), str(tmp_path / "a.svg")]):
        assert (code, "torch" in heavy) == (0, False)


def test_a_drawing_imports_nothing_that_only_rarer_pictures_need(tmp_path):
    large = Image.new("RGB", (512, 512), "white")
    pen = ImageDraw.Draw(large)
    pen.rounded_rectangle((50, 90, 330, 400), 60, "#1f4e79")
    pen.ellipse((200, 150, 470, 420), "#f2a900")
    pen.polygon([(60, 480), (240, 250), (300, 490)], "#b02a30")
    large.resize((128, 128), Image.Resampling.BOX).save(tmp_path / "a.png")
    files = [str(tmp_path / "a.png"), "-o", str(tmp_path / "a.svg")]
    drawn = ["vectorize", *files, "--threads", "1", "--style", "artwork"]
    ((code, found),) = imported(drawn)
    assert (code, [name for name in found if name in (*RARE, *OTHERS)]) == (0, [])
    assert (tmp_path / "a.svg").stat().st_size < 1500  # bytes: a drawing, not a photo


@pytest.mark.parametrize(("arguments", "count"), [([], 5), (["bench"], 2)])
def test_commands_are_described_within_80_columns(arguments, count, run_cli, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    listed = run_cli(*arguments, "--help").stdout.decode().partition("Commands:\n")[2].splitlines()
    assert len(listed) >= count
    assert not [line for line in listed if line.endswith("...") or len(line) > 80]


def main_with(monkeypatch, error: BaseException) -> None:
    def fail(_: object) -> None:
        raise error

    monkeypatch.setattr(app_module, "run_command", fail)
    __main__.main()


@pytest.mark.parametrize(("error", "code"), [(InputError("bad\nfile"), 1), (UsageError("bad option"), 2)])
def test_our_errors_are_one_line_and_an_exit_code(monkeypatch, capsys, error, code):
    with pytest.raises(SystemExit) as end:
        main_with(monkeypatch, error)
    out, err = capsys.readouterr()
    assert end.value.code == code
    assert out == ""
    assert err == f"cubicsplat: error: {str(error).replace(chr(10), ' ')}\n"


def test_too_little_memory_is_one_line(monkeypatch, capsys):
    with pytest.raises(SystemExit) as end:
        main_with(monkeypatch, MemoryError("cairo returned CAIRO_STATUS_NO_MEMORY"))
    assert end.value.code == 1
    assert capsys.readouterr().err.startswith("cubicsplat: error: there is not enough memory for this; give")


def test_interrupt_ends_with_130(monkeypatch):
    with pytest.raises(SystemExit) as end:
        main_with(monkeypatch, KeyboardInterrupt())
    assert end.value.code == 130


def test_other_errors_are_not_swallowed(monkeypatch):
    with pytest.raises(ZeroDivisionError):
        main_with(monkeypatch, ZeroDivisionError())


def test_public_names_exist():
    assert set(cubicsplat_cli.__all__) <= set(dir(cubicsplat_cli))
    for name in cubicsplat_cli.__all__:
        assert getattr(cubicsplat_cli, name) is not None
    with pytest.raises(AttributeError, match="nonsense"):
        _ = cubicsplat_cli.nonsense


def test_doctor_reports_versions_renderers_and_engine(run_cli, capsys):
    done = run_cli("doctor", "--json")
    found = json.loads(done.stdout)
    assert found["version"] == __version__
    assert found["problems"] == []
    assert found["packages"]["torch"]
    assert set(found["renderers"]) == {"cairosvg", "resvg"}
    assert found["engine"]["cpu"]["available"] is True
    doctor_module.doctor()
    text = capsys.readouterr().out
    assert f"cubicsplat {__version__}" in text
    assert found["packages"]["svgwrite"] in text
    assert "cpu" in text


def test_doctor_names_problems(monkeypatch, package):
    from cubicsplat_cli.cli import doctor
    from cubicsplat_cli.raster import engines

    monkeypatch.setattr(engines, "describe", lambda: {"cpu": {"available": False, "reason": "no library"}})
    for name in ("cairosvg", "resvg_py"):
        package(name, f'raise ImportError("no {name}")')
    found = doctor.examine()
    assert any("no library" in problem for problem in found["problems"])
    assert any("renderer" in problem for problem in found["problems"])
    with pytest.raises(typer.Exit) as end:
        doctor.doctor(json=True)
    assert end.value.exit_code == 1


def seconds_of(command: list[str]) -> float:
    """CPU seconds of a command in a process of its own, which is not itself measured under `make coverage`."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("COVERAGE")}
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(command, env=environment, capture_output=True, check=True)
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


LEAST_APP = """
import typer
app = typer.Typer()
@app.command()
def nothing(number: int = 1) -> None:
    pass
app(["--help"])
"""


@pytest.mark.skipif(resource is None, reason="no resource module on this system")
@pytest.mark.parametrize(
    ("arguments", "most"), rest_slow((("--version",), 0.4), (("vectorize", "--help"), 1.5), (("--help",), 1.5), fast=2)
)
def test_version_and_help_are_quick(arguments, most):
    # In the time of the help of a command that does nothing, which is mostly the libraries' and the machine's. That may
    # be busy: more attempts where the first takes longer.
    least = [sys.executable, "-c", LEAST_APP]
    assert any(seconds_of([*cli_command(), *arguments]) < most * seconds_of(least) for _ in range(8))


def test_completion_knows_commands_options_and_choices(run_cli, monkeypatch):
    def completed(words: str) -> list[str]:
        monkeypatch.setenv("COMP_WORDS", words)
        monkeypatch.setenv("COMP_CWORD", str(words.count(" ")))
        return run_cli().stdout.decode().split()

    monkeypatch.setenv("_CUBICSPLAT_COMPLETE", "complete_bash")
    assert completed("cubicsplat vec") == ["vectorize"]
    assert {"--curves", "--colors"} <= set(completed("cubicsplat vectorize --c"))
    assert completed("cubicsplat vectorize --preset h") == ["high"]


@pytest.mark.parametrize("arguments", [["vectorize", ""], ["vectorize", "x.png", "-o", ""]])
def test_an_empty_name_is_an_unset_variable(arguments, run_cli):
    run_cli(*arguments, code=2, error="a file name is empty")


@pytest.mark.parametrize(("moved", "module"), [("artwork", "artwork"), ("paper", "paper"), ("thorns", "spikes")])
def test_a_benchmark_that_moved_says_where_to(moved, module, run_cli):
    said = f"cubicsplat: error: bench {moved} is now `python -m benchmarks.{module}`, to be run in a checkout\n"
    run_cli("bench", moved, "DIR", "--json", code=2, error=said)


def test_an_unknown_command_of_a_group_is_told_its_commands(run_cli):
    run_cli("bench", "speed", code=2, error="the commands are step, quality\n")
    run_cli("bench", "qualty", code=2, error="did you mean quality?\n")


@pytest.mark.parametrize(
    ("present", "earlier"),
    [
        (["--set", "spike-penalty=0.5"], ["--thorn-reg", "0.5"]),
        (["--set", "crossing_penalty=0.5"], ["--geometric-reg=0.5"]),
        (["--set", "importance=visibility", "--set", "flatten=de-casteljau"],
         ["--importance", "visibility", "--flatten", "de-casteljau"]),
        (["--set", "edges=soft", "--set", "prune=no"], ["--edges", "soft", "--no-prune"]),
        (["--set", "opaque=true", "--set", "samples=20", "--set", "segments=2"],
         ["--opaque", "--samples", "20", "--segments", "2"]),
        (["--no-completion"], ["--completion", "off"]),
        (["--set", "detail=2"], ["--detail", "2"]),
    ],
)  # fmt: skip
def test_options_of_earlier_versions_go_on_working(present, earlier, monkeypatch):
    now, before = (asked_by(monkeypatch, "vectorize", "x.png", *words) for words in (present, earlier))
    assert now.digest() == before.digest() != Request().digest()


def test_the_library_takes_the_same_names_and_those_of_earlier_versions():
    from cubicsplat_cli.from_options import request_of

    assert request_of({"thorn_reg": 0.5}) == request_of({"spike_penalty": 0.5}) != Request()
    assert request_of({"completion": "off", "detail": 2.0}).of_artwork() == ["detail", "completion"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("edge_strat=3", "--set knows no 'edge_strat'; did you mean edge_start?; --set help lists the names"),
        ("importance=lo", "--set importance must be loo or visibility, not 'lo'"),
        ("seed-size=x", "--set seed-size must be a number of at least 0, not 'x'"),
        ("finish=1", "--set finish must be a number from 0 to 0.999, not 1.0"),
        ("opaque", "--set takes NAME=VALUE, such as importance=visibility, not 'opaque'"),
    ],
)
def test_a_wrong_set_is_one_clear_line(given, said, run_cli):
    run_cli("vectorize", "x.png", "--set", given, code=2, error=f"cubicsplat: error: {said}\n")
