"""Checks the wheels in a folder: for any Python 3, one native library each, which loads on this machine.

    python tools/check_wheel.py dist

Needs nothing but Python: the package itself, with torch, is not installed.
"""

from __future__ import annotations

import ctypes
import re
import sys
import tempfile
import zipfile
from pathlib import Path

LIBRARY = re.compile(r"cubicsplat_cli/raster/_cubicsplat\.(so|dylib|dll)")
NAME = re.compile(r"cubicsplat-[\w.]+-py3-none-(?!any)[\w.]+\.whl")


def problem_of(wheel: Path, folder: Path) -> str | None:
    """What is wrong with a wheel, whose library is unpacked into a folder; None where nothing is."""
    if not NAME.fullmatch(wheel.name):
        return "its name is not that of a wheel for any Python 3 on one platform"
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        libraries = [name for name in names if LIBRARY.fullmatch(name)]
        if len(libraries) != 1:
            return f"it holds {len(libraries)} native libraries, not one"
        if "cubicsplat_cli/py.typed" not in names:
            return "the marker of typed packages is missing"
        path = archive.extract(libraries[0], folder)
    try:
        library = ctypes.CDLL(path)
    except OSError as error:
        return f"its library does not load: {error}"
    library.cs_isa_names.restype = ctypes.c_char_p
    print(f"{wheel.name}: version {library.cs_abi_version()} of the interface, {library.cs_isa_names().decode()}")
    return None


def main(arguments: list[str]) -> int:
    """The exit code: 0 where there are wheels and all of them are right."""
    wheels = sorted(Path(arguments[0]).glob("*.whl")) if len(arguments) == 1 else []
    if not wheels:
        print("check_wheel: error: give a folder that holds wheels", file=sys.stderr)
        return 2
    # Windows cannot remove a library that is in use.
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        problems = {wheel.name: problem_of(wheel, Path(folder) / wheel.stem) for wheel in wheels}
    for name, problem in problems.items():
        if problem is not None:
            print(f"check_wheel: error: {name}: {problem}", file=sys.stderr)
    return int(any(problems.values()))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
