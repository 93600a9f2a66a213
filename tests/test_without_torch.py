"""The way of a picture on the CPU never imports torch, and computes in numpy what a GPU's way computes in torch."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from conftest import smooth_pixels
from PIL import Image
from test_fit import picture, settings

from cubicsplat_cli.photo.geometric import Regulariser
from cubicsplat_cli.photo.initial import new_curves
from cubicsplat_cli.photo.inputs import FitInputs
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.photo.state import BestCheckpoint
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Rates
from cubicsplat_cli.settings import Mode

# Runs the command with each line of arguments in one process, and says after each whether torch is there.
RUNS = """
import contextlib, json, os, sys
from cubicsplat_cli.__main__ import main
for arguments in json.loads(sys.argv[1]):
    sys.argv = ["cubicsplat", *arguments]
    with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
        try:
            main()
        except SystemExit as end:
            code = end.code
    print(json.dumps([code, "torch" in sys.modules]))
"""
# As on a machine without a GPU, whatever this one has.
NO_GPU = "from cubicsplat_cli.raster import engines\nengines.gpus = lambda: 0\n"


def runs(folder, lines: list[list[str]]) -> list[tuple[int, bool]]:
    command = [sys.executable, "-c", NO_GPU + RUNS, json.dumps(lines)]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=280, cwd=folder)
    print(done.stderr)
    assert len(done.stdout.splitlines()) == len(lines), done.stderr
    return [tuple(json.loads(line)) for line in done.stdout.splitlines()]


def test_no_command_on_the_cpu_imports_torch(tmp_path):
    for name in ("a.png", "many/b.png", "many/c.png"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        Image.fromarray(smooth_pixels(48, 36)).save(tmp_path / name)
    Image.fromarray(smooth_pixels(1100, 800)).save(tmp_path / "large.jpg")
    Image.fromarray(smooth_pixels(48, 36)[..., 0]).save(tmp_path / "mask.png")
    usual = ["--style", "photo", "--preset", "draft", "--steps", "12", "--curves", "12", "--threads", "1", "--force"]
    fit = ["vectorize", "a.png", "-o"]
    penalties = ["--set", "spike-penalty=1", "--set", "crossing-penalty=0.01"]
    lines = [
        [*fit, "a.svg", *usual],
        [*fit, "open.svg", *usual, "--device", "cpu", "--mode", "open"],
        [*fit, "all.svg", *usual, "--fill", "linear", "--loss", "huber", *penalties, "--weights", "mask.png",
         "--focus", "8,8,20,20", "--report", "--animation", "a.webp"],
        [*fit, "b.svg", *usual, "--init", "a.svg"],
        [*fit, "b.svg", *usual[:-3], "--force", "--curves", "20", "--init", "a.svg", "--freeze"],
        ["vectorize", "a.png", "-o", "b.svg", "--style", "photo", "--steps", "12", "--max-bytes", "900", "--force"],
        ["vectorize", "large.jpg", "-o", "large.svg", *usual],
        ["vectorize", "many", "-o", "out", *usual, "--jobs", "1"],
        ["vectorize", "a.png", "-o", "c.svg", "--style", "artwork", "--force"],
        ["eval", "a.png", "a.svg"],
        ["render", "a.svg", "-o", "r.png"],
    ]  # fmt: skip
    for arguments, (code, imported) in zip(lines, runs(tmp_path, lines), strict=True):
        assert (code, imported) == (0, False), arguments


def test_the_library_without_its_operator_imports_no_torch():
    code = (
        "import sys, cubicsplat_cli as c\n"
        "c.vectorize, c.fit, c.Scene, c.Gradients, c.read_svg, c.render_scene, c.compare, c.Result\n"
        "assert 'torch' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=200)


@pytest.mark.parametrize("ragged", [False, True])
@pytest.mark.parametrize("mode", list(Mode))
def test_what_a_step_does_outside_the_engine_waits_for_no_value(mode, ragged):
    """torch's "meta" device stands for a GPU: it has no values to wait for, and refuses to be mixed with the CPU."""
    import torch

    given = settings(mode=mode.value, fill="linear")
    here = new_curves(
        *(np.random.default_rng(1).random(shape, np.float32) for shape in ((6, 13, 2), (6, 3))), 1.0, given, (11, 9)
    )
    here = replace(here, points=here.points[:, : 12 + (mode is Mode.OPEN)].copy())
    there = (here.with_room(here.points.shape[1] + 3, 1) if ragged else here).as_torch("meta")
    frames, stops = torch.zeros(6, 2, 4, device="meta"), torch.zeros(6, 2, 4, device="meta")
    still = torch.zeros(6, dtype=torch.bool, device="meta")
    assert there.for_engine().gradients.frames.device == frames.device
    for mask in (None, still):
        there.fills.learn(there.middles(), frames, stops, Rates(0.1, 0.1, 0.1, 0.1), mask)
    best = BestCheckpoint()
    for _ in range(2):
        best.consider(torch.zeros((), device="meta"), there)
    recipe = replace(given.recipe, crossing_penalty=0.1)
    found = Regulariser(recipe, mode, (11, 9), 24).crossing_gradient(there.points, there.ring_ends)
    assert found.shape == there.points.shape


@pytest.mark.parametrize(
    ("changes", "guided"),
    [
        ({}, False), ({"mode": "open"}, False), ({"fill": "linear"}, False), ({"background": "none"}, True),
        ({"spike_penalty": 0.1, "crossing_penalty": 0.01, "edges": "soft", "finish": 0.0}, False),
        ({"loss": "l2:1,ms-ssim:1", "mode": "open"}, False), ({"loss": "huber", "seeding": "discs"}, True),
    ],
    ids=str,
)  # fmt: skip
def test_a_fit_in_torchs_arrays_is_that_in_numpys(changes, guided):
    """What protects the way of a GPU, all of whose steps outside the engine are those of this fit in tensors. After 40
    steps a rounding of the picture changes the result as well.
    """
    import torch

    target, given = picture(), settings(steps=20, **changes)
    inputs = FitInputs()
    if guided:
        start = FitLoop(target, settings(steps=20, curves=5, seed=3)).finish().scene
        weights = np.linspace(0.5, 2.0, target.shape[0] * target.shape[1], dtype=np.float32).reshape(target.shape[:2])
        inputs = FitInputs(weights, start, frozen=True)
    drawn = []

    class Noting(CpuEngine):
        at_once = 1

        def step(self, scene, settings, training):
            drawn.append(type(scene.points))
            return super().step(scene, settings, training)

    ours, theirs = (
        FitLoop(pixels, given, inputs=inputs, opened=lambda *_, **__: Noting(1)).finish()
        for pixels in (target, torch.from_numpy(target))
    )
    assert drawn == [np.ndarray] * 20 + [torch.Tensor] * 20
    assert theirs.replaced == ours.replaced > 0
    assert theirs.history[-1]["psnr_db"] == pytest.approx(ours.history[-1]["psnr_db"], abs=0.005)
    assert theirs.scene.curves == ours.scene.curves
    for name, values in ours.scene.arrays_by_name().items():
        other = theirs.scene.arrays_by_name()[name]
        assert isinstance(other, np.ndarray)
        assert np.median(np.abs(values - other)) <= 1e-5 * max(1.0, np.abs(values).max()), name
