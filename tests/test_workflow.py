"""Continuous integration asks for what there is: targets of the Makefile, tools, Pythons that the package allows."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
LOCAL = ROOT / ".ci" / "run"
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")


def commands(path: Path) -> list[str]:
    """The lines that a shell gets to see."""
    text = path.read_text(encoding="utf-8")
    return re.findall(r"^\s*- run: (.*)$", text, re.MULTILINE) if path == WORKFLOW else text.splitlines()


@pytest.mark.parametrize("path", [WORKFLOW, LOCAL], ids=["hosted", "local"])
def test_the_targets_it_makes_exist(path):
    asked = [name for line in commands(path) for name in re.findall(r"\bmake ((?:[a-z-]+ ?)+)", line.split("#")[0])]
    targets = {name for names in asked for name in names.split()}
    assert {"lint", "test"} <= targets
    for name in targets:
        assert re.search(rf"^{name}:", MAKEFILE, re.MULTILINE), name


def test_the_tools_it_runs_exist():
    tools = [name for line in commands(WORKFLOW) for name in re.findall(r"python (\S+\.py)", line)]
    assert tools
    for name in tools:
        assert (ROOT / name).is_file(), name


def test_it_tests_every_python_from_the_least_that_the_package_allows():
    text = WORKFLOW.read_text(encoding="utf-8")
    tested = re.findall(r'"(3\.\d+)"', re.search(r"python: \[(.*)\]", text).group(1))
    least = re.search(r'^requires-python = ">=(3\.\d+)"', (ROOT / "pyproject.toml").read_text(), re.MULTILINE).group(1)
    first = int(least.split(".")[1])
    assert tested == [f"3.{first + i}" for i in range(len(tested))]
    assert len(tested) >= 4


def test_its_actions_are_of_a_stated_version_and_its_token_can_only_read():
    text = WORKFLOW.read_text(encoding="utf-8")
    used = re.findall(r"uses: (\S+)", text)
    assert used
    assert all(re.fullmatch(r"actions/[a-z-]+@v\d+", action) for action in used)
    assert re.search(r"^permissions:\n  contents: read$", text, re.MULTILINE)
    assert "\t" not in text
