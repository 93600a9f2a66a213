"""The import of cairosvg, of which a command's start would otherwise be mostly made."""

from __future__ import annotations

import ctypes.util
import hashlib
import importlib
import importlib.util
import marshal
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any

from cubicsplat_cli.files.cache import read_cache, write_cache
from cubicsplat_cli.progress import COMMAND_BEGAN

CACHE = "cairo"  # kind of what is kept on disk
DECLARATIONS = "cairocffi.ffi"  # the module that parses cairo's header


def import_cairosvg() -> ModuleType:
    """cairosvg. Raises what its import raises.

    Its cairocffi parses cairo's header whenever it is imported, which takes a tenth of a second. A command keeps what
    comes of that in the user's cache. Programs that use this package as a library may need the rest of that module.
    """
    header = None if COMMAND_BEGAN.get() is None or "cairocffi" in sys.modules else _header()
    if header is None:
        return importlib.import_module("cairosvg")
    key = hashlib.sha256(header).hexdigest()
    kept = read_cache(CACHE, key)
    if kept is not None:
        sys.modules[DECLARATIONS] = ModuleType(DECLARATIONS)
        exec(marshal.loads(kept), sys.modules[DECLARATIONS].__dict__)
    with _searched_by_the_loader():
        cairosvg = importlib.import_module("cairosvg")
    if kept is None and (parsed := sys.modules.get(DECLARATIONS)) is not None:
        write_cache(CACHE, key, marshal.dumps(_parsed(parsed.ffi)))
    return cairosvg


def _header() -> bytes | None:
    """All that the parsed declarations depend on; None where they depend on more."""
    package = importlib.util.find_spec("cairocffi")
    if package is None or package.origin is None or importlib.util.find_spec("xcffib") is not None:
        return None
    cffi = importlib.import_module("_cffi_backend").__version__
    sources = (Path(package.origin).with_name(name).read_bytes() for name in ("ffi.py", "constants.py"))
    versions = f"{sys.implementation.cache_tag} {sys.version_info} {cffi}".encode()
    return b"\n".join((*sources, importlib.util.MAGIC_NUMBER, versions))


def _parsed(ffi: Any) -> Any:
    """The code of a module with the declarations of an FFI."""
    ffi.set_source(DECLARATIONS, None, compiler_verbose=0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "ffi.py")
        ffi.emit_python_code(str(path))
        return compile(path.read_bytes(), DECLARATIONS, "exec")


@contextmanager
def _searched_by_the_loader() -> Iterator[None]:
    """Within, Linux' dynamic loader finds cairo by itself: cairocffi would run a compiler and a linker first, to look
    for the names that cairo has on Windows.
    """
    found = ctypes.util.find_library
    if sys.platform == "linux":
        ctypes.util.find_library = lambda name: None
    try:
        yield
    finally:
        ctypes.util.find_library = found
