"""The pages of `make docs`: all are in the menu, what they refer to is there, the examples of docs/python.md run."""

from __future__ import annotations

import importlib.util
import re
from pathlib import Path

import pytest
from conftest import smooth_pixels
from PIL import Image

import cubicsplat_cli

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
# Made by `make docs` itself.
MADE = {"gallery.md"}
PAGES = sorted(path for path in DOCS.rglob("*.md") if path.name not in MADE)
TEXT = (ROOT / "docs" / "python.md").read_text(encoding="utf-8")
EXAMPLES = re.findall(r"^```python\n(.*?)^```$", TEXT, re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!https?:)([^)#\s]*)(?:#([^)\s]+))?\)")


def anchors(path: Path) -> set[str]:
    """What the headings of a page are called in links."""
    headings = re.findall(r"^#+ (.*)$", path.read_text(encoding="utf-8"), re.MULTILINE)
    return {re.sub(r"[^a-z0-9 -]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


def test_every_page_is_in_the_menu_once():
    menu = re.findall(r"^ +- [^:\n]+: (\S+\.md)$", (ROOT / "mkdocs.yml").read_text(encoding="utf-8"), re.MULTILINE)
    assert sorted(menu) == sorted({path.relative_to(DOCS).as_posix() for path in PAGES} | MADE)


@pytest.mark.parametrize("page", [*PAGES, ROOT / "README.md", ROOT / "CONTRIBUTING.md"], ids=lambda path: path.name)
def test_what_a_page_refers_to_is_there(page):
    text = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.MULTILINE | re.DOTALL)
    found = LINK.findall(text)
    for name, anchor in found:
        target = page if not name else page.parent / name
        assert target.is_file() or target.name in MADE, f"{page.name} refers to {name}, which is not there"
        if anchor and target.suffix == ".md":
            assert anchor in anchors(target), f"{page.name} refers to {name}#{anchor}"
    for name in re.findall(r'<img src="([^"]+)"', text):
        assert (page.parent / name).is_file(), f"{page.name} shows {name}, which is not there"


def test_pages_that_the_code_names_are_there():
    files = [ROOT / "Makefile", *(path for name in ("src", "tools", "tests") for path in (ROOT / name).rglob("*.py"))]
    named = {name for path in files for name in re.findall(r"\bdocs/[\w/-]+\.md", path.read_text(encoding="utf-8"))}
    assert len(named) >= 4
    assert not [name for name in named if not (ROOT / name).is_file() and Path(name).name not in MADE]


def test_the_pages_ask_for_nothing_from_elsewhere():
    text = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    assert "font: false" in text
    assert "strict: true" in text
    assert not re.search(r"https?://", text)


def test_bars_in_the_code_of_tables_are_shown_as_such():
    spec = importlib.util.spec_from_file_location("pages", ROOT / "tools" / "pages.py")
    hook = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hook)
    text = "| `--mode closed\\|open` | a \\| b |\n`kept\\|here`\n"
    assert hook.on_page_markdown(text, page=None) == "| `--mode closed|open` | a \\| b |\n`kept\\|here`\n"


def test_the_examples_run_as_typed_one_after_the_other_and_print_nothing_of_their_own(tmp_path, monkeypatch, capfd):
    Image.fromarray(smooth_pixels(64, 48)).save(tmp_path / "photo.png")
    monkeypatch.chdir(tmp_path)
    names: dict[str, object] = {}
    assert len(EXAMPLES) >= 7
    for example in EXAMPLES:
        exec(compile(example, "docs/python.md", "exec"), names)
    out, err = capfd.readouterr()
    assert err == ""
    assert len(out.splitlines()) == sum(example.count("print(") for example in EXAMPLES)
    assert cubicsplat_cli.read_svg((tmp_path / "large.svg").read_text()).width == 128


def test_the_example_of_a_loss_is_short():
    (example,) = [example for example in EXAMPLES if "ms_ssim" in example]
    assert len([line for line in example.splitlines() if line.strip()]) < 30


def test_every_public_name_is_typed_and_documented():
    for name in cubicsplat_cli.__all__:
        assert getattr(cubicsplat_cli, name).__doc__ or name == "__version__", name
    assert (Path(cubicsplat_cli.__file__).parent / "py.typed").is_file()


@pytest.mark.parametrize(
    "picture",
    [
        smooth_pixels(24, 20),
        smooth_pixels(24, 20, alpha=True),
        smooth_pixels(24, 20)[..., 0],
        smooth_pixels(24, 20) / 255.0,
        Image.fromarray(smooth_pixels(24, 20)),
        Image.fromarray(smooth_pixels(24, 20)).convert("P"),
    ],
)
def test_pictures_of_every_kind_are_taken(picture):
    result = cubicsplat_cli.vectorize(picture, style="photo", curves=6, steps=10, threads=1)
    assert (result.report.input.width, result.report.input.height) == (24, 20)
    assert cubicsplat_cli.compare(picture, result).psnr_db == pytest.approx(result.report.quality.svg.psnr_db, abs=1e-6)


@pytest.mark.parametrize(
    "wrong",
    [3, smooth_pixels(8, 8).astype(int), smooth_pixels(8, 8) * 1.0, smooth_pixels(8, 8)[:, :, :2], b"no picture"],
)
def test_what_is_no_picture_is_refused(wrong):
    with pytest.raises(cubicsplat_cli.InputError):
        cubicsplat_cli.vectorize(wrong)
