"""Draw SVG bytes with an independent renderer: cairosvg, or resvg on systems without libcairo."""

from __future__ import annotations

import ctypes.util
import hashlib
import importlib.util
import io
import marshal
import math
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from cubicsplat_cli.errors import EngineError, InputError, UsageError
from cubicsplat_cli.files.write import read_cache, write_cache
from cubicsplat_cli.formatting import one_line
from cubicsplat_cli.progress import COMMAND_BEGAN
from cubicsplat_cli.record import record
from cubicsplat_cli.svg.values import picture_in

if TYPE_CHECKING:
    from cubicsplat_cli.svg.untrusted import SvgSize

# cairo's image surfaces end at 32767 px a side; the area bounds the memory (4 bytes a pixel, with resvg more).
MAX_SIDE = 32_767
MAX_RENDER_PIXELS = 2**28
RENDERERS = ("cairosvg", "resvg")
# The places of red, green, blue and alpha in cairo's pixel, a native 32-bit number with alpha first.
RGBA = [2, 1, 0, 3] if sys.byteorder == "little" else [1, 2, 3, 0]
_PACKAGES = {"cairosvg": "cairosvg", "resvg": "resvg_py"}
DECLARATIONS = "cairocffi.ffi"  # the module that parses cairo's header


@record
class Rendered:
    """A drawn SVG. pixels: (H, W, 4) uint8 straight RGBA, on a transparent ground. renderer: name and version. note: a
    sentence for the user about the choice of the renderer, or None.
    """

    pixels: np.ndarray
    renderer: str
    note: str | None


def available_renderers() -> dict[str, tuple[str | None, str | None]]:
    """Return (version, None) of each renderer in the order of preference; (None, problem and remedy) if it fails."""
    loaded = {name: _load(name) for name in RENDERERS}
    return {name: (getattr(module, "__version__", None), problem) for name, (module, problem) in loaded.items()}


def rerender(svg: bytes, width: int, height: int, *, renderer: str = "auto", source: str = "the SVG") -> Rendered:
    """Draw SVG bytes that this package made at width x height px, on a transparent ground.

    source: the name for messages. renderer: "cairosvg", "resvg", or "auto" for the first that works; a note tells
    of a fallback. Raises UsageError for another name, InputError for an impossible size or bytes that cannot be drawn,
    EngineError if the renderer (or, for auto, every renderer) is missing.
    """
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE) or width * height > MAX_RENDER_PIXELS:
        limits = f"at most {MAX_SIDE} px a side and {MAX_RENDER_PIXELS / 1e6:.0f} megapixels"
        raise InputError(f"a picture of {width} x {height} px cannot be drawn: {limits}; choose a smaller scale")
    module, name, note = choose_renderer(renderer)
    with drawing_with(name, source):
        if name == "cairosvg":
            pixels = _straight(draw_by_cairo(module, svg, width, height))
        else:
            # resvg keeps the SVG's shape; viewers centre it (xMidYMid meet).
            pixels = draw_by_resvg(module, svg.decode("utf-8"), width, height)
            down, across = height - pixels.shape[0], width - pixels.shape[1]
            pixels = np.pad(pixels, ((down // 2, down - down // 2), (across // 2, across - across // 2), (0, 0)))
    return Rendered(pixels, f"{module.__name__} {module.__version__}", note)


@contextmanager
def drawing_with(name: str, source: str) -> Iterator[None]:
    """Turn any error of a renderer into one InputError that names the file."""
    try:
        yield
    except (KeyboardInterrupt, SystemExit, MemoryError):
        raise
    except BaseException as error:  # resvg's panics are no Exceptions
        # Both renderers raise nearly any exception for an SVG that they cannot draw; the fault is the file's.
        reason = _reason(error, name)
        said = f" ({reason})" if reason else ""
        raise InputError(f"{source}: {name} cannot draw it{said}; check the file in a viewer") from error


def _reason(error: BaseException, name: str) -> str:
    """Return a renderer's complaint in words for users, maybe none."""
    text = one_line(error)
    if isinstance(error, UnicodeError):
        return "it is not UTF-8"
    if match := re.search(r"could not convert string to float: (.*)", text) or re.search(r"b'(.*)'$", text):
        return f"{match[1]} is no number" if "float" in text else match[1]
    # The sentences of resvg and of the XML parser are clear; cairosvg fails with any exception of Python.
    clear = isinstance(error, (InputError, SyntaxError)) or (name == "resvg" and isinstance(error, ValueError))
    return text if clear else ""


def rerender_untrusted(
    svg: bytes, *, source: str, width: int | None = None, height: int | None = None, scale: float = 1.0,
    renderer: str = "auto",
) -> tuple[Rendered, SvgSize]:  # fmt: skip
    """Draw an SVG of unknown origin after `check_untrusted`: at width x height, or at one of these with the other by
    its shape, or at its own size times `scale`.

    Returns the picture and the natural size, which is width x height for an SVG without a size if both are given. An
    SVG of another shape is centred, as in viewers. Raises the errors of `check_untrusted` and `rerender`, and
    UsageError for a scale that is not positive and finite.
    """
    svg, size, drawn = checked(svg, source, width, height, scale)
    whole = [max(1, round(side)) for side in (drawn.width, drawn.height)]
    return rerender(svg, *whole, renderer=renderer, source=source), size


def checked(
    svg: bytes, source: str, width: float | None = None, height: float | None = None, scale: float = 1.0
) -> tuple[bytes, SvgSize, SvgSize]:
    """Check an SVG of unknown origin; return it with a size, that size, and the size to draw it at.

    Parameters and errors are those of `rerender_untrusted`.
    """
    from cubicsplat_cli.svg.untrusted import SvgSize, check_untrusted, with_size

    if not (math.isfinite(scale) and scale > 0):
        raise UsageError(f"must be a positive number, not {scale:g}", "scale")
    asked = SvgSize(width, height) if width and height else None
    size = check_untrusted(svg, source, otherwise=asked)
    if size is asked:
        svg = with_size(svg, size)
    factor = width / size.width if width else height / size.height if height else scale
    return svg, size, asked or SvgSize(size.width * factor, size.height * factor)


def install_hint() -> str:
    """Return the command that installs libcairo on this system."""
    hints = {"darwin": "brew install cairo", "win32": "install the GTK 3 runtime, which brings cairo"}
    return hints.get(sys.platform, "apt-get install libcairo2")


def choose_renderer(renderer: str = "auto") -> tuple[ModuleType, str, str | None]:
    """Return the module to draw with, the renderer's name, and a note if it is not the preferred one.

    Raises UsageError for an unknown name, EngineError if the renderer (for auto: every renderer) is missing.
    """
    if renderer not in ("auto", *RENDERERS):
        raise UsageError(f"renderer must be one of {', '.join(RENDERERS)}, not {renderer!r}")
    problems: list[str] = []
    for name in RENDERERS if renderer == "auto" else (renderer,):
        module, problem = _load(name)
        if module is not None:
            return module, name, f"drawn by {name}: {'; '.join(problems)}" if problems else None
        problems.append(problem or "")
    missing = "no SVG renderer is" if renderer == "auto" else f"the renderer {renderer} is not"
    raise EngineError(f"{missing} available: {'; '.join(problems)}")


def _load(name: str) -> tuple[ModuleType | None, str | None]:
    """Import a renderer, or return the problem and its remedy."""
    try:
        return import_cairosvg() if name == "cairosvg" else importlib.import_module(_PACKAGES[name]), None
    except OSError as error:
        # cairocffi looks for the shared library while it is imported.
        first_line = str(error).splitlines()[0] if str(error) else type(error).__name__
        return None, f"{name} found no libcairo ({first_line}); {install_hint()}"
    except ImportError as error:
        return None, f"{name} cannot be imported ({error}); pip install {_PACKAGES[name]}"


def draw_by_resvg(module: ModuleType, svg: str, width: int, height: int) -> np.ndarray:
    """Draw an SVG's text within width x height px, (h, w, 4) uint8 straight RGBA. Raises any error of resvg."""
    from PIL.PngImagePlugin import PngImageFile

    # Our own files hold no text, and the search for fonts would take longer than drawing.
    no_fonts = "<text" not in svg
    png = module.svg_to_bytes(svg_string=svg, width=width, height=height, skip_system_fonts=no_fonts, dpi=96)
    # Pillow's size limit guards against foreign files; this one has a checked size.
    with PngImageFile(io.BytesIO(bytes(png))) as image:
        return np.asarray(image.convert("RGBA"))


def embedded_only(url: str, _resource_type: str) -> bytes:
    """Return the file of an embedded PNG or JPEG, for cairosvg. Raises InputError for any other reference."""
    if url.startswith("data:"):
        try:
            return picture_in(url)[0]
        except ValueError as error:
            raise InputError(f"the SVG {error}") from error
    raise InputError(f"the SVG refers to {url[:80]}, which is never fetched")


def draw_by_cairo(
    module: ModuleType, svg: bytes, width: int, height: int, part: tuple[int, int, int, int] | None = None
) -> np.ndarray:
    """Draw an SVG at width x height px, or a part of that: left, top, width and height in px.

    Returns (h, w, 4) uint8 premultiplied, with channels in the order of RGBA. module: cairosvg. Raises its errors.
    """
    left, top, part_width, part_height = part or (0, 0, width, height)
    surfaces = importlib.import_module(f"{module.__name__}.surface")
    trees = importlib.import_module(f"{module.__name__}.parser")
    cairo = surfaces.cairo
    pixels = np.zeros((part_height, part_width, 4), np.uint8)
    memory = pixels.reshape(-1).data

    class OnPixels(surfaces.PNGSurface):  # type: ignore[misc, name-defined]
        def _create_surface(self, whole_width: float, whole_height: float) -> tuple[object, float, float]:
            surface = cairo.ImageSurface(cairo.FORMAT_ARGB32, part_width, part_height, memory, 4 * part_width)
            surface.set_device_offset(-left, -top)
            return surface, whole_width, whole_height

    tree = trees.Tree(bytestring=svg, unsafe=False, url_fetcher=embedded_only)
    OnPixels(tree, None, 96, output_width=width, output_height=height).cairo.finish()
    return pixels


def _straight(pixels: np.ndarray) -> np.ndarray:
    """Return a result of `draw_by_cairo` as straight RGBA, rounded as in cairo's PNG files."""
    straight = pixels[..., RGBA]
    alpha = straight[..., 3:]
    if int(alpha.min()) < 255:
        straight[..., :3] = (straight[..., :3] * np.uint16(255) + alpha // 2) // np.maximum(alpha, 1)
    return straight


def import_cairosvg() -> ModuleType:
    """Import cairosvg. Raises the errors of its import.

    cairocffi parses cairo's header at every import, which takes a tenth of a second. A command caches the result.
    In other programs the import is the ordinary one, since they may need the rest of that module.
    """
    header = None if COMMAND_BEGAN.get() is None or "cairocffi" in sys.modules else _header()
    if header is None:
        return importlib.import_module("cairosvg")
    key = hashlib.sha256(header).hexdigest()
    kept = read_cache("cairo", key)
    if kept is not None:
        sys.modules[DECLARATIONS] = ModuleType(DECLARATIONS)
        exec(marshal.loads(kept), sys.modules[DECLARATIONS].__dict__)
    with _searched_by_the_loader():
        cairosvg = importlib.import_module("cairosvg")
    if kept is None and (parsed := sys.modules.get(DECLARATIONS)) is not None:
        write_cache("cairo", key, marshal.dumps(_parsed(parsed.ffi)))
    return cairosvg


def _header() -> bytes | None:
    """Return all that the parsed declarations depend on; None if they depend on more."""
    package = importlib.util.find_spec("cairocffi")
    if package is None or package.origin is None or importlib.util.find_spec("xcffib") is not None:
        return None
    cffi = importlib.import_module("_cffi_backend").__version__
    sources = (Path(package.origin).with_name(name).read_bytes() for name in ("ffi.py", "constants.py"))
    versions = f"{sys.implementation.cache_tag} {sys.version_info} {cffi}".encode()
    return b"\n".join((*sources, importlib.util.MAGIC_NUMBER, versions))


def _parsed(ffi: Any) -> Any:
    """Return the code of a module with the declarations of an FFI."""
    ffi.set_source(DECLARATIONS, None, compiler_verbose=0)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "ffi.py")
        ffi.emit_python_code(str(path))
        return compile(path.read_bytes(), DECLARATIONS, "exec")


@contextmanager
def _searched_by_the_loader() -> Iterator[None]:
    """Let Linux' dynamic loader find cairo: cairocffi would first run a compiler and a linker, to look for the names
    that cairo has on Windows.
    """
    find_library = ctypes.util.find_library
    if sys.platform == "linux":
        ctypes.util.find_library = lambda name: None
    try:
        yield
    finally:
        ctypes.util.find_library = find_library
