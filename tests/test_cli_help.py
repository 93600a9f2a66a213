"""The help of the commands, and docs/cli.md, which says all that it does."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
import typer

from cubicsplat_cli.artwork.settings import ArtworkSettings
from cubicsplat_cli.cli import app as app_module
from cubicsplat_cli.metrics import FURTHER
from cubicsplat_cli.options import LOSSES, settings_of
from cubicsplat_cli.request import STYLES
from cubicsplat_cli.settings import FitSettings, Recipe

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
COMMANDS = dict(typer.main.get_command(app_module.application(*app_module.COMMANDS)).commands)
COMMANDS |= {f"bench {name}": command for name, command in COMMANDS.pop("bench").commands.items()}
OPTION = re.compile(r"(?<![\w-])(--?[a-z][a-z-]*)")


def section(command: str) -> str:
    """The part of docs/cli.md about one command."""
    text = (DOCS / "cli.md").read_text(encoding="utf-8")
    parts = re.split(r"^## cubicsplat ([a-z]+(?: [a-z]+)?).*$", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))[command]


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_option_of_the_help_is_documented_and_none_else(command, run_cli):
    done = run_cli(*command.split(), "--help")
    in_help = set()
    for line in done.stdout.decode().splitlines():
        if re.match(r"  -", line):
            in_help |= set(OPTION.findall(re.split(r"\s{2,}", line.strip())[0]))
    shown, _, left_out = section(command).partition("### Options that the help leaves out")
    rows = [line.split("|")[1] for line in shown.splitlines() if line.startswith("| `-")]
    assert {"--help", "-h"} <= in_help
    assert in_help == {"--help", "-h", *OPTION.findall(" ".join(rows))}
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
    assert len(lines) <= 90
    assert len([line for line in lines if re.match(r"\s+-", line)]) <= 45


def recipe_rows() -> Iterator[str]:
    """The table of docs/cli.md about the names of --set."""

    def text(value: object) -> str:
        return f"{value:g}" if isinstance(value, float) else str(value).lower()

    usual, paper = FitSettings(), FitSettings(preset="paper")
    for here, there in ((usual, paper), (usual.recipe, paper.recipe), (ArtworkSettings(), ArtworkSettings())):
        for field, known in settings_of(type(here)):
            if known.by_set:
                choices = " or ".join(f"`{choice}`" for choice in known.choices)
                meaning = f"{known.help} {choices}." if choices else known.help
                default, published = (text(getattr(each, field.name)) for each in (here, there))
                published = "" if published == default else published
                yield f"| `{field.name.replace('_', '-')}` | {default} | {published} | {meaning} |"


def test_the_names_of_set_are_documented():
    rows = list(recipe_rows())
    assert len(rows) > 40
    assert "\n".join(rows) in section("vectorize")


def test_set_help_lists_the_names_without_a_picture(run_cli):
    done = run_cli("vectorize", "--set", "help")
    lines = done.stdout.decode().splitlines()
    assert len(lines) == len(list(recipe_rows()))
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
        name = (parameter.opts or parameter.secondary_opts)[0]
        if name in rows and parameter.default not in (None, False, True, "", []):
            default = getattr(parameter.default, "value", parameter.default)
            assert rows[name][1] == str(default), name
            checked += 1
    assert checked >= 4


def test_the_docs_name_every_style_loss_and_metric():
    rows = {line.split("`")[1]: line for line in section("vectorize").splitlines() if line.startswith("| `")}
    for option, names in (("--style NAME", STYLES), ("--loss LOSS", LOSSES)):
        assert {name for name in names if f"`{name}`" not in rows[option]} == set()
    metrics = (DOCS / "quality.md").read_text(encoding="utf-8")
    assert {name for name in FURTHER if f"| `{name}` |" not in metrics} == set()


def test_documented_choices_are_the_real_ones():
    rows = option_rows(section("vectorize"))
    for owner in (FitSettings, ArtworkSettings):
        for field, known in settings_of(owner):
            if known.choices and not known.by_set and not known.hidden:
                option = f"--{field.name.replace('_', '-')}"
                assert f"`{option} {'/'.join(known.choices)}`" == rows[option][0]


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
