"""The drawing that a fit begins with."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.files.marks import sha256_of
from cubicsplat_cli.files.read import read_file
from cubicsplat_cli.formatting import printable
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import Mode
from cubicsplat_cli.svg.reader import read_svg

ASPECT_TOLERANCE = 0.01  # sides of canvases are whole pixels


@dataclass(frozen=True, eq=False)
class Beginning:
    """A scene to begin a fit with, of any size; name and sha256: of where it comes from. notes: what the user should
    know of how it was read, a sentence each.
    """

    scene: Scene
    name: str
    sha256: str
    notes: tuple[str, ...] = ()

    def check_shape(self, width: int, height: int) -> None:
        """Raise InputError where a picture of width x height px has another shape."""
        scene = self.scene
        if abs(scene.width * height / (scene.height * width) - 1.0) > ASPECT_TOLERANCE:
            raise InputError(
                f"the drawing {self.name} has {scene.width} x {scene.height} px, another shape than the picture's "
                f"{width} x {height}; use an SVG with the picture's proportions"
            )


def load_beginning(source: str | Path | bytes, mode: Mode = Mode.CLOSED) -> Beginning:
    """A drawing, from its path or bytes: as cubicsplat wrote it, or as near as any other SVG comes to a scene.

    mode: what is wanted of an SVG of others. Raises InputError, with its name, for what is no SVG or shows no shape.
    """
    data = source if isinstance(source, bytes) else read_file(Path(source))
    name = "the SVG" if isinstance(source, bytes) else printable(str(source))
    try:
        scene, notes = read_svg(data), list[str]()
    except InputError:
        from cubicsplat_cli.beginning.foreign import read_foreign

        scene, notes = read_foreign(data, name, mode)
    return Beginning(scene, name, sha256_of(data), tuple(notes))
