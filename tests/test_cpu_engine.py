"""What only the native CPU engine has: threads, instruction sets, de Casteljau subdivision, counts."""

from __future__ import annotations

from ctypes import c_double
from dataclasses import replace

import numpy as np
import pytest
import torch
from engines import packed, state_for
from scenes import PAPER, random_scene, random_target

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Rates, Training
from cubicsplat_cli.raster.native import address_of, native
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode


@pytest.mark.parametrize("mode", list(Mode))
@pytest.mark.parametrize("coverage", ["relaxed", "exact"])
def test_results_do_not_depend_on_threads(mode, coverage):
    scene = random_scene(mode, 60, 3, 150, 90, 1, background=PAPER)
    target = random_target(scene)
    results = []
    for threads in (1, 2, 5):
        engine = CpuEngine(threads)
        parameters = packed(replace(scene, colours=scene.colours * 4 - 2, opacities=scene.opacities * 4 - 2))
        parameters.logits = True
        state, importance = state_for(parameters), torch.zeros(scene.curves)
        for _ in range(5):
            loss = engine.step(
                parameters, RasterSettings(coverage, 1.0, 8), Training(target, state, Rates(0.5, 0.05, 0.05, 0.1),
                out={"importance": importance}, importance="loo"),
            )  # fmt: skip
        results.append((loss, parameters.points, parameters.colours, parameters.half_widths, importance))
    for other in results[1:]:
        for a, b in zip(results[0], other, strict=True):
            assert a == b if isinstance(a, float) else torch.equal(a, b)


def test_a_closed_engine_says_so():
    engine = CpuEngine(1)
    engine.close()
    engine.close()
    scene = packed(random_scene(Mode.CLOSED, 3, 2, 20, 20, 1, background=PAPER))
    with pytest.raises(EngineError, match="is closed"):
        engine.render(scene, RasterSettings("relaxed", 1.0, 8))


def test_an_unknown_instruction_set_is_refused():
    with pytest.raises(EngineError, match="instruction set mmx"):
        CpuEngine(1, "mmx")


@pytest.mark.parametrize("writeable", [True, False])
def test_arrays_that_are_not_contiguous_are_refused(writeable):
    """Their addresses alone do not say where the values are."""
    whole = np.arange(24.0).reshape(4, 6)
    whole.flags.writeable = writeable
    assert native("sum", "cs_trimmed_range", 6, whole, 0.0, result=c_double) == pytest.approx(20.0, abs=0.2)
    for part in (whole[:, ::2], whole.T):
        with pytest.raises(EngineError, match="contiguous by rows, not one of shape"):
            native("sum", "cs_trimmed_range", 3, part, 0.0, result=c_double)
        with pytest.raises(EngineError, match="contiguous by rows"):
            address_of(part)
