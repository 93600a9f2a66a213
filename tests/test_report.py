"""The typed report: what is written is what the schema says, and what is read back is what was written."""

from __future__ import annotations

import json
from dataclasses import fields, replace
from importlib import resources

import numpy as np
import pytest
from conftest import smooth_pixels

from cubicsplat_cli import vectorize
from cubicsplat_cli.metrics import Report
from cubicsplat_cli.request import STYLES

jsonschema = pytest.importorskip("jsonschema")
SCHEMA = json.loads(resources.files("cubicsplat_cli").joinpath("metrics.schema.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def reports() -> dict[str, Report]:
    """Of a photo, of one that was not measured, and of artwork."""
    photo, flat = smooth_pixels(40, 28), np.full((20, 24, 3), 200, np.uint8)
    flat[5:15, 6:18] = (20, 60, 120)
    small = {"curves": 9, "steps": 20, "threads": 1}
    return {
        "photo": vectorize(photo, style="photo", **small).report,
        "unmeasured": vectorize(photo, style="photo", measure=False, **small).report,
        "artwork": vectorize(flat, style="artwork", threads=1).report,
    }


def test_the_schema_names_every_style():
    assert ["auto", *SCHEMA["properties"]["style"]["enum"]] == list(STYLES)


@pytest.mark.parametrize("kind", ["photo", "unmeasured", "artwork"])
def test_a_report_is_as_its_schema_says_and_reads_back(reports, kind):
    report = reports[kind]
    found = json.loads(report.to_json())
    jsonschema.Draft202012Validator(SCHEMA).validate(found)
    assert set(found) == set(SCHEMA["properties"]) == {field.name for field in fields(Report)}
    back = Report.from_json(report.to_json())
    assert back.to_json() == report.to_json()
    assert (report.quality is None) == (kind == "unmeasured")
    assert (report.style, report.inks is None) == ("artwork" if kind == "artwork" else "photo", kind != "artwork")


@pytest.mark.parametrize(
    "damage",
    [
        lambda found: found.pop("output"),
        lambda found: found.update(schema=2),
        lambda found: found.update(program="other"),
        lambda found: found["timing"].update(total_s="long"),
        lambda found: found.update(notes={}),
        lambda found: found.update(input=[]),
        lambda found: found["output"].update(bytes=True),
    ],
)
def test_what_is_no_report_is_refused(reports, damage):
    found = json.loads(reports["photo"].to_json())
    damage(found)
    with pytest.raises(ValueError, match=r"."):
        Report.from_json(json.dumps(found))


def test_half_a_report_is_refused_and_members_of_a_newer_version_are_not(reports):
    text = reports["photo"].to_json()
    with pytest.raises(ValueError, match=r"."):
        Report.from_json(text[:200])
    newer = json.loads(text) | {"unheard_of": 1}
    assert Report.from_json(json.dumps(newer)) == Report.from_json(text)


def test_values_that_json_has_no_number_for_become_null(reports):
    report = reports["photo"]
    odd = replace(report, timing=replace(report.timing, ms_per_step=float("nan")))
    assert json.loads(odd.to_json())["timing"]["ms_per_step"] is None
