"""What holds for the command as a whole: fast --help, exit codes, errors, and complete documentation."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer
from command import cli_command, run_process
from conftest import rest_slow
from PIL import Image, ImageDraw

import cubicsplat_cli
from cubicsplat_cli import __main__
from cubicsplat_cli._version import __version__
from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.cli import app as app_module
from cubicsplat_cli.cli import doctor as doctor_module
from cubicsplat_cli.errors import InputError, UsageError
from cubicsplat_cli.options import settings_of
from cubicsplat_cli.request import Request
from cubicsplat_cli.settings import FitSettings, Recipe

try:
    import resource
except ImportError:  # Windows
    resource = None

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
COMMANDS = dict(typer.main.get_command(app_module.application(*app_module.COMMANDS)).commands)
COMMANDS |= {f"bench {name}": command for name, command in COMMANDS.pop("bench").commands.items()}
HEAVY = ("torch", "numpy", "skimage", "cairosvg", "resvg_py", "svgwrite", "PIL", "scipy")
# What only scans, enlargements, blurred pictures, strokes and photos need; any part of scipy takes 0.2 s to import.
RARE = ("torch", "skimage", "scipy", "svgwrite", "cubicsplat_cli.photo.loop", "cubicsplat_cli.artwork.strokes.find")
OTHERS = ("cubicsplat_cli.cli.bench", "cubicsplat_cli.cli.render", "pydantic")  # other commands and wrong options
OPTION = re.compile(r"(?<![\w-])(--?[a-z][a-z-]*)")


def section(command: str) -> str:
    """The part of docs/cli.md about one command."""
    text = (DOCS / "cli.md").read_text(encoding="utf-8")
    parts = re.split(r"^## cubicsplat ([a-z]+(?: [a-z]+)?).*$", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))[command]


def test_version():
    done = run_process("--version")
    assert (done.returncode, done.stdout.decode().strip()) == (0, f"cubicsplat {__version__}")
    assert cubicsplat_cli.__version__ == __version__


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_option_of_the_help_is_documented_and_none_else(command, run_cli):
    done = run_cli(*command.split(), "--help")
    assert done.returncode == 0
    in_help = set()
    for line in done.stdout.decode().splitlines():
        if re.match(r"  -", line):
            in_help |= set(OPTION.findall(re.split(r"\s{2,}", line.strip())[0]))
    shown, _, left_out = section(command).partition("### Options that the help leaves out")
    rows = [line.split("|")[1] for line in shown.splitlines() if line.startswith("| `-")]
    assert {"--help", "-h"} <= in_help
    assert in_help == set(OPTION.findall(" ".join(rows)))
    declared = {True: set(), False: set()}
    for option in COMMANDS[command].params:
        names = {name for name in [*option.opts, *option.secondary_opts] if name[0] == "-"}
        declared[getattr(option, "hidden", False)] |= names
    assert declared[False] <= in_help, "the help was not understood"
    named = {re.sub("^--no-", "--", name) for name in OPTION.findall(left_out)}
    renamed = {"--thorn-reg": "--spike-penalty", "--geometric-reg": "--crossing-penalty"}
    assert {re.sub("^--no-", "--", name) for name in declared[True]} <= {renamed.get(name, name) for name in named}


@pytest.mark.parametrize("columns", ["80", "100"])
def test_the_help_of_vectorize_fits_into_two_screens(columns, run_cli, monkeypatch):
    monkeypatch.setenv("COLUMNS", columns)
    lines = run_cli("vectorize", "--help").stdout.decode().splitlines()
    assert len(lines) <= 86
    assert len([line for line in lines if re.match(r"\s+-", line)]) <= 45


def recipe_rows() -> Iterator[str]:
    """The table of docs/cli.md about the names of --set."""

    def text(value: object) -> str:
        return f"{value:g}" if isinstance(value, float) else str(value).lower()

    usual, paper = FitSettings(), FitSettings(preset="paper")
    for here, there in ((usual, paper), (usual.recipe, paper.recipe), (ArtworkSettings(), ArtworkSettings())):
        for field, known in settings_of(type(here)):
            if known.by_set:
                choices = known.choices or (("true", "false") if known.kind == "flag" else ())
                values = " ".join(f"`{choice}`" for choice in choices) or known.values()
                default, published = (text(getattr(each, field.name)) for each in (here, there))
                published = "" if published == default else published
                yield f"| `{field.name.replace('_', '-')}` | {values} | {default} | {published} | {known.help} |"


def test_the_names_of_set_are_documented():
    rows = list(recipe_rows())
    assert len(rows) > 40
    assert "\n".join(rows) in section("vectorize")


def test_set_help_lists_the_names_without_a_picture(run_cli):
    done = run_cli("vectorize", "--set", "help")
    lines = done.stdout.decode().splitlines()
    assert done.returncode == 0 and len(lines) == len(list(recipe_rows()))
    assert (
        "finish                     0.15  Share of the steps that use exact coverage.  [a number from 0 to 0.999]"
        in lines
    )


def test_the_help_of_vectorize_is_in_groups_and_in_the_words_of_people(run_cli, monkeypatch):
    for columns in ("80", "40"):
        monkeypatch.setenv("COLUMNS", columns)
        text = run_cli("vectorize", "--help").stdout.decode()
        groups = re.findall(r"^(\w[\w ]*?)(?: \(imply .*\))?:$", text, re.MULTILINE)
        assert groups == ["Arguments", "Most used", "Photos and drawings", "Photos", "Drawings", "Structure", "Files"]
        options = [
            set(OPTION.findall(part))
            for part in re.split(r"^\w[\w ]*(?: \(imply .*\))?:$", text, flags=re.MULTILINE)[1:]
        ]
        assert {"--output", "--curves", "--style", "--preset", "--force", "--help"} <= options[1]
        assert {"--loss", "--init"} <= options[3] and {"--colors", "--max-nodes"} <= options[4]
        assert "Photos (imply --style photo):" in text and "Drawings (imply --style artwork):" in text
        assert re.search(r"^  --mode closed\|open", text, re.MULTILINE)
        assert "--time-limit SECONDS" in text
        assert not re.search(r"[<{]", text), "the parser's names of types"
        assert max(map(len, text.splitlines())) <= int(columns) + 10


@pytest.mark.parametrize("command", ["eval", "render", "bench step"])
def test_other_commands_have_one_group(command, run_cli):
    text = run_cli(*command.split(), "--help").stdout.decode()
    assert re.findall(r"^(\w[\w ]*):$", text, re.MULTILINE)[-1] == "Options"
    assert not re.search(r"[<{]", text)


def option_rows(text: str) -> dict[str, tuple[str, str]]:
    """First two cells, option and default, of the tables' rows by the option's name; "/" stands for an escaped bar."""
    rows = {}
    for line in text.splitlines():
        if line.startswith("| `--"):
            cells = [cell.strip() for cell in line.replace(r"\|", "/").split("|")[1:-1]]
            rows[OPTION.findall(cells[0])[0]] = (cells[0], cells[1])
    return rows


def test_the_readme_names_options_and_defaults_as_the_full_table_does():
    short = option_rows((ROOT / "README.md").read_text(encoding="utf-8"))
    assert len(short) >= 10
    assert short.items() <= option_rows(section("vectorize")).items()


@pytest.mark.parametrize("command", ["vectorize", "bench step", "bench quality"])
def test_documented_defaults_are_the_real_ones(command):
    rows = option_rows(section(command))
    checked = 0
    for parameter in COMMANDS[command].params:
        name = parameter.opts[0]
        if name in rows and parameter.default not in (None, False, True, "", []):
            default = getattr(parameter.default, "value", parameter.default)
            assert rows[name][1] == str(default), name
            checked += 1
    assert checked >= 4


def test_documented_choices_are_the_real_ones():
    rows = option_rows(section("vectorize"))
    for owner in (FitSettings, ArtworkSettings):
        for field, known in settings_of(owner):
            if known.choices and not known.by_set and not known.only_off:
                option = f"--{field.name.replace('_', '-')}"
                assert f"`{option} {'/'.join(known.choices)}`" == rows[option][0]


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
    drawn = ["vectorize", str(tmp_path / "a.png"), "-o", str(tmp_path / "a.svg"), "--threads", "1"]
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
    assert done.returncode == 0, done.stdout
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
    from cubicsplat_cli import raster
    from cubicsplat_cli.cli import doctor

    monkeypatch.setattr(raster, "describe", lambda: {"cpu": {"available": False, "reason": "no library"}})
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
    done = run_cli(*arguments)
    assert done.returncode == 2
    assert b"a file name is empty" in done.stderr


def test_every_setting_of_a_fit_has_one_option_and_the_library_takes_it():
    held = [(owner, field, known) for owner in (FitSettings, Recipe) for field, known in settings_of(owner)]
    names = [field.name for _, field, known in held if not known.by_set or known.hidden_option]
    defaults = {p.name: p.default for p in COMMANDS["vectorize"].params if p.name in names}
    assert set(defaults) == set(names)
    assert FitSettings.from_preset(**defaults) == FitSettings()
    chosen = {
        "curves": 9, "mode": "open", "preset": "draft", "steps": 3, "time_limit": 4.5, "segments": 2, "samples": 9,
        "device": "cpu", "threads": 2, "seed": 5, "background": "teal", "opaque": True, "prune": False,
        "importance": "visibility", "crossing_penalty": 0.5, "spike_penalty": 0.25, "flatten": "de-casteljau",
        "edges": "soft", "loss": "l1", "fill": "linear", "shapes": "any",
    }  # fmt: skip
    assert set(chosen) == set(names)
    settings = FitSettings.from_preset(**chosen)
    for name, value in {**chosen, "background": "#008080"}.items():
        holder = settings if hasattr(settings, name) else settings.recipe
        assert getattr(holder, name) == value, name


@pytest.mark.parametrize(("moved", "module"), [("artwork", "artwork"), ("paper", "paper"), ("thorns", "spikes")])
def test_a_benchmark_that_moved_says_where_to(moved, module, run_cli):
    done = run_cli("bench", moved, "DIR", "--json")
    assert done.returncode == 2
    assert done.stderr.decode() == (
        f"cubicsplat: error: bench {moved} is now `python -m benchmarks.{module}`, to be run in a checkout\n"
    )


def test_an_unknown_command_of_a_group_is_told_its_commands(run_cli):
    assert run_cli("bench", "speed").stderr.decode().endswith("the commands are step, quality\n")
    assert run_cli("bench", "qualty").stderr.decode().endswith("did you mean quality?\n")


def asked_by(run_cli, monkeypatch, *arguments: str) -> Request:
    """The request that a command line makes."""
    from cubicsplat_cli.cli import vectorize as module

    asked: list[Request] = []

    def planned(inputs, output, request, **_):
        asked.append(request)
        raise UsageError("enough")

    monkeypatch.setattr(module, "plan", planned)
    done = run_cli("vectorize", "x.png", *arguments)
    assert asked, done.stderr
    return asked[0]


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
def test_options_of_earlier_versions_go_on_working(present, earlier, run_cli, monkeypatch):
    found = asked_by(run_cli, monkeypatch, *present)
    assert found.digest() == asked_by(run_cli, monkeypatch, *earlier).digest() != Request().digest()


def test_the_library_takes_the_same_names_and_those_of_earlier_versions():
    from cubicsplat_cli.request import request_of

    assert request_of({"thorn_reg": 0.5}) == request_of({"spike_penalty": 0.5}) != Request()
    assert request_of({"completion": "off", "detail": 2.0}).of_artwork() == ["detail", "completion"]


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ("edge_strat=3", "--set knows no 'edge_strat'; did you mean edge_start?; --set help lists the names"),
        ("importance=lo", "--set importance must be loo or visibility, not 'lo'; did you mean loo?"),
        ("seed-size=x", "--set seed-size must be a number of at least 0, not 'x'"),
        ("finish=1", "--set finish must be a number from 0 to 0.999, not 1.0"),
        ("opaque", "--set takes NAME=VALUE, such as importance=visibility, not 'opaque'"),
    ],
)
def test_a_wrong_set_is_one_clear_line(given, said, run_cli):
    done = run_cli("vectorize", "x.png", "--set", given)
    assert (done.returncode, done.stderr.decode()) == (2, f"cubicsplat: error: {said}\n")
