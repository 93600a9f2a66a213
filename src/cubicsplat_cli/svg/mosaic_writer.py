"""Mosaics of cells as plain SVG 1.1: a path for each colour, of horizontal and vertical lines in whole steps."""

from __future__ import annotations

from collections.abc import Callable
from xml.etree import ElementTree

import numpy as np

from cubicsplat_cli.artwork.geometry.steps import suggested_precision, to_steps
from cubicsplat_cli.artwork.mosaic import CellLayer, Mosaic
from cubicsplat_cli.artwork.shapes import colour_group, colour_name
from cubicsplat_cli.svg.drawing_writer import group_element
from cubicsplat_cli.svg.markup import Identifiers, document, empty_document, format_number, paint
from cubicsplat_cli.svg.quantise import check_precision


def write_mosaic(
    mosaic: Mosaic, *, precision: int | None = None, title: str, comment: str, grouped: bool = False
) -> str:
    """The SVG text of a mosaic; arguments and errors as of `write_drawing`. grouped: each colour is in a group."""
    if precision is None:
        precision = suggested_precision(mosaic.width, mosaic.height)
    check_precision(precision)
    root, names = empty_document(mosaic.width, mosaic.height, title, comment), Identifiers()
    for layer in mosaic.layers:
        data = _layer_path(layer, precision)
        if data:
            held = group_element(root, colour_group(layer.fill) if grouped else "", names)
            name = names.unique(_layer_name(layer, mosaic))
            held.append(ElementTree.Element("path", {"id": name, "d": data, **paint(layer.fill)}))
    return document(root)


def _layer_name(layer: CellLayer, mosaic: Mosaic) -> str:
    corners, _ = layer.loops
    whole = len(corners) == 4 and (np.ptp(corners, axis=0) == (mosaic.width, mosaic.height)).all()
    return "background" if whole else colour_name(layer.fill)


def _layer_path(layer: CellLayer, precision: int) -> str:
    """The loops of a layer in steps of 10^-precision px, relative, so that like forms are the same text."""
    places, ends = layer.loops
    corners = to_steps(places, precision)
    starts = np.concatenate([[0], ends[:-1]])
    steps = np.diff(corners, axis=0, append=corners[:1])
    # A loop has as many level as upright sides: these take turns throughout the layer.
    level, upright = _texts(steps[::2, 0], "h", precision), _texts(steps[1::2, 1], "v", precision)
    tokens = [token for pair in zip(level, upright, strict=True) for token in pair]
    begins = np.diff(corners[starts], axis=0, prepend=np.zeros((1, 2), dtype=np.int64))
    across, down = _texts(begins[:, 0], "zm", precision), _texts(begins[:, 1], "", precision)
    for start, end, x, y in zip(starts.tolist(), ends.tolist(), across, down, strict=True):
        tokens[start] = f"{x}{y if y[0] == '-' else f' {y}'}{tokens[start]}"
        tokens[end - 1] = ""  # what closes the loop
    return "M" + "".join(tokens)[2:] + "z" if tokens else ""


def _texts(values: np.ndarray, letter: str, precision: int) -> list[str]:
    """Each of the numbers (n,), in steps, as text after a letter."""
    different, which = np.unique(values, return_inverse=True)
    texts: Callable[[int], str] = [letter + format_number(int(value), precision) for value in different].__getitem__
    return [texts(index) for index in which.tolist()]
