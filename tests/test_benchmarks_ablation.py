"""`benchmarks.ablation`: rows, means and changes, in the table and in the JSON."""

from __future__ import annotations

import pytest
from cli_runs import strict_json

from benchmarks import ablation
from cubicsplat_cli.bench import runs
from cubicsplat_cli.errors import EngineError, UsageError
from cubicsplat_cli.settings import FitSettings

SHORT = ("--steps", 12, "--threads", 1)


def test_ablation_rows_are_settings_that_exist_and_that_change_something():
    base = FitSettings.from_preset("standard", mode="closed")
    for row, changes in ablation.ABLATIONS.items():
        settings = FitSettings.from_preset("standard", mode="closed", **changes)
        assert (settings == base) == (row == ablation.BASE), row
        for name, value in changes.items():
            assert getattr(settings if hasattr(settings, name) else settings.recipe, name) == value


def test_ablation_table_and_json_agree(run_benchmark, two_pictures, tmp_path):
    options = ("--curves", "4,6", "--mode", "closed,open", "--rows", "opaque,no pruning", "--cache", tmp_path / "c")
    done = run_benchmark("ablation", two_pictures, *options, *SHORT, "--json")
    found = strict_json(done.stdout)
    rows = found["rows"]
    assert [row["row"] for row in rows[:3]] == ["base", "no pruning", "opaque"], "in the order of the table"
    assert len(rows) == 12
    levels = {(row["row"], row["mode"], row["curves"]): row["psnr_db"] for row in rows}
    for row in rows:
        change = row["psnr_db"] - levels["base", row["mode"], row["curves"]]
        assert row["change_db"] == pytest.approx(change, abs=1e-3)
        assert row["steps_per_minute"] > 100
    assert any(abs(row["change_db"]) > 0.01 for row in rows)
    table = run_benchmark("ablation", two_pictures, *options, *SHORT, "--markdown", "-q").stdout.decode().splitlines()
    assert [cell.strip() for cell in table[0].split("|")[1:6]] == [
        "row", "closed 4 dB", "change", "own - SVG", "steps/min",
    ]  # fmt: skip
    assert len(table) == 2 + 3
    opaque = [cell.strip() for cell in table[-1].split("|")[1:-1]]
    assert opaque[0] == "opaque"
    assert float(opaque[1]) == pytest.approx(levels["opaque", "closed", 4], abs=0.006)


def test_change_is_over_the_pictures_that_both_have(run_benchmark, two_pictures, monkeypatch):
    original = runs.vectorize_picture

    def fail_one(picture, request, **options):
        if request.settings.recipe.opaque and picture.source.endswith("b.png"):
            raise EngineError("broke")
        return original(picture, request, **options)

    monkeypatch.setattr(runs, "vectorize_picture", fail_one)
    done = run_benchmark(
        "ablation", two_pictures, "--curves", 4, "--mode", "closed", "--rows", "opaque", *SHORT, "--json", code=1
    )
    found = strict_json(done.stdout)
    base, opaque = found["rows"]
    levels = {(run["picture"], run["configuration"]): run["psnr_db"] for run in found["runs"]}
    want = levels["a.png", "closed 4, opaque"] - levels["a.png", "closed 4, base"]
    assert opaque["change_db"] == pytest.approx(want, abs=1e-6)
    assert (base["pictures"], opaque["pictures"]) == (2, 1)


def test_all_rows_without_a_choice_and_unknown_ones_are_refused():
    assert ablation.chosen_rows(None) == list(ablation.ABLATIONS)
    assert ablation.chosen_rows(["base"]) == ["base"]
    with pytest.raises(UsageError, match="nonsense"):
        ablation.chosen_rows(["nonsense"])
