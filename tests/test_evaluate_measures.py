"""MS-SSIM, LPIPS and CIEDE2000 of pictures: known values, transparency, small pictures, missing packages."""

from __future__ import annotations

import importlib
import json
import sys
from types import ModuleType
from urllib.error import URLError

import numpy as np
import pytest
import torch
from conftest import smooth_pixels
from PIL import Image
from skimage.color import deltaE_ciede2000, rgb2lab

from cubicsplat_cli.errors import EngineError, UsageError
from cubicsplat_cli.evaluate import perceptual as module
from cubicsplat_cli.evaluate.perceptual import further, straight_rgba
from cubicsplat_cli.files.load import as_picture
from cubicsplat_cli.metrics import NAMES, chosen_metrics, figures_text

LARGE = smooth_pixels(200, 176)


def noisy(pixels: np.ndarray, amount: int) -> np.ndarray:
    noise = np.random.default_rng(0).integers(-amount, amount + 1, pixels.shape)
    return np.clip(pixels.astype(int) + noise, 0, 255).astype(np.uint8)


def test_names_are_checked():
    assert chosen_metrics(" LPIPS, psnr,psnr") == ("lpips", "psnr")
    assert chosen_metrics(",".join(NAMES)) == NAMES
    for wrong in ("", "psnr,vmaf"):
        with pytest.raises(UsageError, match="psnr, ssim, ms-ssim, lpips, de00"):
            chosen_metrics(wrong)


def test_ciede2000_is_the_mean_over_the_pixels(monkeypatch):
    other = noisy(LARGE, 9)
    wanted = deltaE_ciede2000(rgb2lab(LARGE), rgb2lab(other)).mean()
    assert further(as_picture(LARGE), other, ["de00"])["de00"] == pytest.approx(wanted, rel=1e-5)
    monkeypatch.setattr(module, "STRIP_PIXELS", 1000)
    assert further(as_picture(LARGE), other, ["de00"])["de00"] == pytest.approx(wanted, rel=1e-5)
    assert further(as_picture(LARGE), LARGE, ["de00", "psnr"]) == {"de00": 0.0}


def test_transparency_counts_on_the_worse_ground():
    first = smooth_pixels(40, 40, alpha=True)
    white, second = first.copy(), first.copy()
    # A white halo shows over black only.
    white[..., :3][white[..., 3] == 0] = 255
    second[0:20, 0:20] = (255, 255, 255, 255)
    found = further(as_picture(first), second, ["de00"])["de00"]
    black = np.where(first[..., 3:] == 255, first[..., :3], 0).astype(np.uint8)
    changed = black.copy()
    changed[0:20, 0:20] = 255
    assert found == pytest.approx(deltaE_ciede2000(rgb2lab(black), rgb2lab(changed)).mean(), rel=1e-5)
    assert further(as_picture(first), white, ["de00"])["de00"] == 0.0
    assert np.array_equal(straight_rgba(as_picture(first))[..., 3], first[..., 3])


def test_ms_ssim_falls_with_noise_and_small_pictures_have_none():
    pytest.importorskip("torchmetrics", reason="needs the extra measures")
    levels = [further(as_picture(LARGE), noisy(LARGE, n), ["ms-ssim"])["ms_ssim"] for n in (0, 8, 40)]
    assert levels[0] == pytest.approx(1.0, abs=1e-4)
    assert 1.0 > levels[1] > levels[2] > 0.2
    small = smooth_pixels(160, 300)
    assert further(as_picture(small), small, ["ms-ssim"]) == {"ms_ssim": None}
    assert list(figures_text({"ms_ssim": None, "de00": 1.0})) == ["MS-SSIM n/a", "dE00 1.000"]


class AlexNet(torch.nn.Module):
    """The convolutions of AlexNet as torchvision has them, which is all that LPIPS looks at."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[torch.nn.Module] = []
        shapes = ((3, 64, 11, 4, 2), (64, 192, 5, 1, 2), (192, 384, 3, 1, 1), (384, 256, 3, 1, 1), (256, 256, 3, 1, 1))
        for index, (before, after, size, stride, padding) in enumerate(shapes):
            layers += [torch.nn.Conv2d(before, after, size, stride, padding), torch.nn.ReLU()]
            layers += [torch.nn.MaxPool2d(3, 2)] if index in (0, 1) else []
        self.features = torch.nn.Sequential(*layers)


@pytest.fixture
def with_network(monkeypatch):
    """Puts a torchvision in place whose AlexNet is what a function makes of the weights asked for."""
    library = pytest.importorskip("torchmetrics.functional.image.lpips", reason="needs the extra measures")

    def put(make) -> None:
        stand_in, models = ModuleType("torchvision"), ModuleType("torchvision.models")
        models.AlexNet_Weights = type("AlexNet_Weights", (), {"DEFAULT": "default"})
        models.alexnet = make
        stand_in.models = models
        monkeypatch.setitem(sys.modules, "torchvision", stand_in)
        monkeypatch.setitem(sys.modules, "torchvision.models", models)
        monkeypatch.setattr(library, "_TORCHVISION_AVAILABLE", True)
        monkeypatch.setattr(importlib.import_module("torchmetrics.image.lpip"), "_TORCHVISION_AVAILABLE", True)

    module._network.cache_clear()
    yield put
    module._network.cache_clear()


def test_lpips_by_a_network_with_weights_made_here(with_network, tmp_path):
    torch.manual_seed(3)
    torch.save(AlexNet().state_dict(), tmp_path / "weights.pth")
    asked = []

    def alexnet(weights):
        asked.append(weights)
        network = AlexNet()
        network.load_state_dict(torch.load(tmp_path / "weights.pth"))
        return network

    with_network(alexnet)
    levels = [further(as_picture(LARGE), noisy(LARGE, n), ["lpips"])["lpips"] for n in (0, 8, 40)]
    assert levels[0] == pytest.approx(0.0, abs=1e-6)
    assert 0.0 < levels[1] < levels[2]
    assert asked == ["default"], "the network is made once, with its usual weights"
    assert further(as_picture(smooth_pixels(31, 90)), smooth_pixels(31, 90), ["lpips"]) == {"lpips": None}


def test_weights_that_cannot_be_had_are_said_in_one_line(with_network):
    def alexnet(weights):
        raise URLError("no route to host")

    with_network(alexnet)
    with pytest.raises(EngineError, match=r"weights .* cannot be had .*no route to host.*put alexnet-owt-7be5be79.pth"):
        further(as_picture(LARGE), LARGE, ["lpips"])


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ImportError("No module named torchmetrics"), r"needs torchmetrics .*cubicsplat\[measures\]"),
        (RuntimeError("operator torchvision::nms does not exist"), "does not belong to this torch"),
    ],
)
def test_packages_that_are_missing_or_do_not_fit(error, words, package):
    package("torchmetrics", f"raise {error!r}")
    with pytest.raises(EngineError, match=words):
        further(as_picture(LARGE), LARGE, ["ms-ssim"])


def test_the_command_prints_and_tabulates_what_was_asked_for(run_cli, tmp_path):
    for folder, amount in (("a", 0), ("b", 12)):
        (tmp_path / folder).mkdir()
        for name in ("x", "y"):
            Image.fromarray(noisy(smooth_pixels(40, 30), amount)).save(tmp_path / folder / f"{name}.png")
    one = run_cli("eval", tmp_path / "a/x.png", tmp_path / "b/x.png", "--metrics", "de00")
    assert b"dE00 " in one.stdout
    assert b" dB" not in one.stdout
    table = tmp_path / "t.csv"
    both = run_cli("eval", tmp_path / "a", tmp_path / "b", "--metrics", "psnr,de00", "--json", "--csv", table)
    found = json.loads(both.stdout)
    levels = [pair["measures"]["de00"] for pair in found["pairs"]]
    assert found["mean"]["de00"] == pytest.approx(sum(levels) / 2, abs=1e-4)
    assert "de00" in table.read_text().splitlines()[0]
    run_cli("eval", tmp_path / "a", tmp_path / "b", "--metrics", "vmaf", code=2)
