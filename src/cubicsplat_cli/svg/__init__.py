"""The SVG side: writing a scene or a drawing as plain SVG 1.1 and reading our own files back."""

from cubicsplat_cli.svg.drawing_reader import read_drawing
from cubicsplat_cli.svg.drawing_writer import write_drawing, write_mosaic
from cubicsplat_cli.svg.quantise import quantise_scene
from cubicsplat_cli.svg.scene_reader import read_svg
from cubicsplat_cli.svg.scene_writer import write_svg

__all__ = ["quantise_scene", "read_drawing", "read_svg", "write_drawing", "write_mosaic", "write_svg"]
