"""The installed package is this checkout, whole, with its native library; one wheel serves every Python.

And continuous integration asks for what there is: targets of the Makefile, tools, Pythons that the package allows.
"""

from __future__ import annotations

import ctypes
import platform
import re
import shutil
import subprocess
import sys
import zipfile
from importlib import metadata
from pathlib import Path

import pytest

import cubicsplat_cli
from cubicsplat_cli._version import __version__

ROOT = Path(__file__).resolve().parents[1]
SOURCE = ROOT / "src" / "cubicsplat_cli"
KERNELS = SOURCE / "raster" / "kernels"
WORKFLOW = ROOT / ".github" / "workflows" / "ci.yml"
LOCAL = ROOT / ".ci" / "run"
MAKEFILE = (ROOT / "Makefile").read_text(encoding="utf-8")
LIBRARY = re.compile(r"cubicsplat_cli/raster/_cubicsplat\.(so|dylib|dll)")
RUNTIME = {
    "array-api-compat",
    "cairosvg", "jinja2", "numpy", "pillow", "resvg-py", "rich", "scikit-image", "scipy", "svgwrite", "torch", "typer",
}  # fmt: skip


def shipped_sources() -> set[str]:
    """Paths below src/ of what belongs in the package, POSIX style."""
    return {
        path.relative_to(ROOT / "src").as_posix()
        for path in SOURCE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts and not path.name.startswith("_cubicsplat.")
    }


@pytest.fixture(scope="module")
def installed() -> metadata.Distribution:
    """The distribution; not being installed is a failure, since tests are about what users get."""
    return metadata.distribution("cubicsplat")


def test_version_has_one_source(installed):
    assert installed.version == __version__
    pattern = re.compile(r"version\s*[=:]\s*[\"']" + re.escape(__version__))
    owners = [path for path in [*SOURCE.rglob("*.py"), ROOT / "pyproject.toml"] if pattern.search(path.read_text())]
    assert owners == [], "the version is written a second time"


def test_installed_package_is_this_checkout(installed):
    folder = Path(cubicsplat_cli.__file__).parent
    assert folder != SOURCE, "tests must run against the installed package, not the source tree"
    present = {
        str(file)
        for file in installed.files
        if str(file).startswith("cubicsplat_cli/") and not str(file).endswith(".pyc")
    }
    libraries = {name for name in present if LIBRARY.fullmatch(name)}
    assert len(libraries) == 1
    assert present - libraries == shipped_sources()
    stale = [
        name for name in shipped_sources() if (folder.parent / name).read_bytes() != (ROOT / "src" / name).read_bytes()
    ]
    assert stale == [], "installed files differ from the checkout: install again (make does)"


def test_kernel_texts_are_installed(installed):
    names = {str(file) for file in installed.files}
    texts = [path for path in KERNELS.rglob("*") if path.suffix in (".h", ".cpp", ".cu", ".cuh")]
    assert {path.suffix for path in texts} >= {".h", ".cpp"}
    for path in texts:
        assert f"cubicsplat_cli/raster/kernels/{path.relative_to(KERNELS).as_posix()}" in names


def test_library_is_plain_c(installed):
    (path,) = [file.locate() for file in installed.files if LIBRARY.fullmatch(str(file))]
    library = ctypes.CDLL(str(path))
    assert not hasattr(library, "PyInit__cubicsplat")
    assert b"libpython" not in Path(path).read_bytes()


def test_wheel_tag_serves_every_python(installed):
    tags = re.findall(r"^Tag: (.*)$", installed.read_text("WHEEL"), re.MULTILINE)
    assert tags
    assert all(re.fullmatch(r"py3-none-(?!any)\w+", tag) for tag in tags), tags


def test_console_script(installed):
    (script,) = [entry for entry in installed.entry_points if entry.group == "console_scripts"]
    assert (script.name, script.value) == ("cubicsplat", "cubicsplat_cli.__main__:main")
    assert callable(script.load())


def test_runtime_requirements_are_open_ranges(installed):
    plain = [text for text in installed.requires if "extra ==" not in text]
    names = {re.match(r"[A-Za-z0-9_.-]+", text).group(0).lower().replace("_", "-") for text in plain}
    assert names == RUNTIME
    assert not [text for text in plain if re.search(r"==|<|~=|@", text)], "a cap breaks other people's installs"


def test_build_needs_no_torch_and_is_portable():
    build = re.search(r"^requires = (\[.*\])$", (ROOT / "pyproject.toml").read_text(), re.MULTILINE).group(1)
    assert re.findall(r'"([A-Za-z-]+)', build) == ["scikit-build-core"]
    commands = [line.split("#")[0] for line in (ROOT / "CMakeLists.txt").read_text().splitlines()]
    assert any("-O3" in line for line in commands)
    assert not any("native" in line for line in commands), "-march=native must not be in what is shipped"


def test_samples_are_small_and_named_in_their_readme():
    readme = (ROOT / "samples" / "README.md").read_text()
    pictures = [path for path in (ROOT / "samples").iterdir() if path.suffix in (".png", ".jpg")]
    assert len(pictures) >= 4
    for path in pictures:
        assert path.stat().st_size <= 300_000
        assert f"`{path.name}`" in readme


@pytest.mark.slow
def test_wheel_from_the_checkout(tmp_path):
    command = [sys.executable, "-m", "pip", "wheel", "--no-deps", "--wheel-dir", str(tmp_path), str(ROOT)]
    subprocess.run(command, check=True, capture_output=True, text=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert re.fullmatch(rf"cubicsplat-{re.escape(__version__)}-py3-none-\w+\.whl", wheel.name)
    names = {name for name in zipfile.ZipFile(wheel).namelist() if ".dist-info/" not in name}
    assert len([name for name in names if LIBRARY.fullmatch(name)]) == 1
    assert {name for name in names if not LIBRARY.fullmatch(name)} == shipped_sources()


@pytest.mark.slow
@pytest.mark.skipif(platform.machine() not in ("x86_64", "AMD64"), reason="instruction sets of x86-64")
@pytest.mark.skipif(not shutil.which("objdump") or not shutil.which("cmake"), reason="needs cmake and objdump")
def test_wide_instructions_stay_behind_the_dispatch(tmp_path):
    """Only the avx2 and avx512 copies use wide registers: anything else would crash older machines."""
    subprocess.run(["cmake", "-S", str(ROOT), "-B", str(tmp_path)], check=True, capture_output=True)
    subprocess.run(["cmake", "--build", str(tmp_path)], check=True, capture_output=True)
    command = ["objdump", "-d", "--no-show-raw-insn", str(tmp_path / "_cubicsplat.so")]
    listing = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    users: dict[str, set[str]] = {"ymm": set(), "zmm": set()}
    function = ""
    for line in listing.splitlines():
        if match := re.fullmatch(r"[0-9a-f]+ <(.*)>:", line):
            function = match.group(1)
        for register, found in users.items():
            if f"%{register}" in line:
                found.add(function)
    assert users["ymm"], "the listing must show the wide copies for this test to mean anything"
    assert users["zmm"]
    assert [name for name in users["ymm"] if "avx" not in name] == []
    assert [name for name in users["zmm"] if "avx512" not in name] == []


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
