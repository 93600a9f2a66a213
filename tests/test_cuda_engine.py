"""What only the CUDA engine has, on the emulator and on a GPU: limits of size, and the first curve that breaks down."""

from __future__ import annotations

import pytest
from engines import CUDA, SETTINGS, open_cuda, packed, state_for
from scenes import PAPER, random_scene, random_target

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.engine import Rates, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.settings import Mode


@pytest.fixture(scope="module", params=CUDA)
def engine(request):
    engine = open_cuda(request.param)
    yield engine
    engine.close()


def test_what_it_cannot_draw_is_named(engine):
    long = packed(random_scene(Mode.CLOSED, 2, 43, background=PAPER), engine.device)
    with pytest.raises(EngineError, match="at most 42 segments and 4096 edges, not 43 and 258"):
        engine.render(long, SETTINGS[0])
    scene = packed(random_scene(Mode.CLOSED, 3, 3, background=PAPER), engine.device)
    with pytest.raises(EngineError, match=r"no de Casteljau subdivision; use uniform samples, or the CPU"):
        engine.render(scene, RasterSettings("relaxed", 1.0, 12, 0.5, subdivide=True))


def test_a_curve_that_stops_being_finite_is_named(engine):
    fresh = type(engine)(driver=engine._driver)
    scene = packed(random_scene(Mode.CLOSED, 6, 3, background=PAPER), engine.device)
    target = random_target(random_scene(Mode.CLOSED, 1, 3, background=PAPER)).to(engine.device)
    state = state_for(scene)
    assert fresh.fault() is None
    for i in range(4):
        if i == 2:
            scene.points[4, 1, 0] = float("nan")
        fresh.step(scene, SETTINGS[1], Training(target, state, Rates(0.1, 0.1, 0.1, 0.0)))
    assert fresh.fault() == (4, 2)
