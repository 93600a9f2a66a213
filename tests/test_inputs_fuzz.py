"""What fuzzing found once, and a short piece of it: `make fuzz` runs the long one."""

from __future__ import annotations

import os
import sys
import time
from collections import Counter
from pathlib import Path

import pytest
from conftest import rest_slow

ROOT = Path(__file__).resolve().parents[1]
sys.path.insert(0, str(ROOT / "tools"))

from fuzz import TARGETS, Campaign, try_input  # noqa: E402
from fuzz_inputs import make_input  # noqa: E402

FINDS = sorted((ROOT / "tests" / "fuzz").glob("*-*"))


@pytest.mark.parametrize("find", FINDS, ids=lambda path: path.name)
@pytest.mark.timeout(100)
def test_what_was_found_once_is_refused_or_read(find):
    assert try_input(find.name.split("-")[0], find.read_bytes()) in ("read", "refused")


@pytest.mark.parametrize("target", ["picture", "drawing"])
@pytest.mark.timeout(200)
@pytest.mark.filterwarnings("ignore")
def test_a_few_hundred_inputs(target):
    outcomes = [try_input(target, make_input(target, number, seed=99)) for number in range(300)]
    assert 20 < outcomes.count("read") < 280, "damage must matter, and must not be all that is seen"


@pytest.mark.timeout(200)
@pytest.mark.filterwarnings("ignore")
def test_a_few_pictures_drawn_as_artwork():
    outcomes = [try_input("artwork", make_input("artwork", number, seed=99)) for number in range(4)]
    assert outcomes.count("read") >= 2, "only a picture that is all transparent leaves nothing to read"


def test_inputs_are_repeatable():
    assert set(TARGETS) == {"picture", "drawing", "artwork"}
    assert make_input("artwork", 17, 3) == make_input("artwork", 17, 3)
    assert make_input("picture", 17, 3) == make_input("picture", 17, 3)
    assert make_input("picture", 17, 3) != make_input("picture", 18, 3)


def tried(pipe, first: int, last: int, misbehave) -> None:
    for number in range(first, last):
        pipe.send(("next", number))
        if number == 3:
            misbehave(number)
        else:
            pipe.send(("counts", Counter(read=1)))
    pipe.send(("end", None))


def hang(pipe, _target: str, _seed: int, first: int, last: int) -> None:
    tried(pipe, first, last, lambda _: time.sleep(60))


def crash(pipe, _target: str, _seed: int, first: int, last: int) -> None:
    tried(pipe, first, last, lambda _: os._exit(7))


def bug(pipe, _target: str, _seed: int, first: int, last: int) -> None:
    tried(pipe, first, last, lambda number: pipe.send(("find", (number, "KeyError"))))


@pytest.mark.parametrize(
    ("misbehave", "said"),
    rest_slow((crash, "died with"), (hang, "took more than"), (bug, "KeyError")),
    ids=lambda given: "",
)
def test_the_watch_notices_hangs_crashes_and_bugs(misbehave, said, tmp_path, capsys):
    """With readers that misbehave at input 3, in the process that is watched."""
    campaign = Campaign("picture", 0, 6, tmp_path, 1.0 if misbehave is hang else 60.0, misbehave)
    campaign.run()
    assert len(campaign.finds) == 1
    assert (tmp_path / campaign.finds[0]).read_bytes() == make_input("picture", 3, 0)
    assert said in capsys.readouterr().out
    assert campaign.counts["read"] == 5
