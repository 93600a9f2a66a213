"""`benchmarks.shapes`: the table of means beside another program's files, and how that program may fail."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
from conftest import rest_slow, smooth_pixels
from PIL import Image

# Writes a grey file for every so many shapes, as primitive does, after enough work for the table's hundredths.
PROGRAM = """#!{python}
import sys
import time
from pathlib import Path
while time.process_time() < 0.05:
    pass
given = dict(zip(sys.argv[1::2], sys.argv[2::2]))
for count in range(int(given["-nth"]), int(given["-n"]) + 1, int(given["-nth"])):
    svg = '<svg xmlns="http://www.w3.org/2000/svg" width="64" height="42"><path fill="#888" d="M0 0h64v42H0z"/></svg>'
    Path(given["-o"] % count).write_text(svg)
sys.exit({code})
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "in").mkdir()
    Image.fromarray(smooth_pixels(48, 32)).save(tmp_path / "in" / "smooth.png")
    return tmp_path / "in"


@pytest.mark.parametrize("code", rest_slow(3, 0))
def test_every_kind_and_number_of_shapes_has_a_row(folder, run_benchmark, code):
    program = folder.parent / "primitive"
    program.write_text(PROGRAM.format(python=sys.executable, code=code))
    program.chmod(0o755)
    done = run_benchmark("shapes", folder, "--primitive", program, "--curves", "4,6", "--steps", 60, code=int(code > 0))
    if code:
        assert b"code 3" in done.stderr
        return
    rows = [line.split() for line in done.stdout.decode().splitlines()[1:]]
    assert [row[:2] for row in rows] == [[k, n] for k in ("triangle", "rectangle", "ellipse") for n in ("4", "6")]
    assert all("smooth" not in row for row in rows), "a grey file is far from it"
    assert all(float(row[4]) > 0.0 for row in rows), "the program's time"
