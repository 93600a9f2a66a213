"""The SVG of a cutout as one SVG per colour with register marks around it, for cutters and screen printing."""

from __future__ import annotations

import copy
from xml.etree.ElementTree import Element, fromstring

from cubicsplat_cli.artwork.shapes import colour_group
from cubicsplat_cli.files.marks import made_mark, sha256_of, with_checksum
from cubicsplat_cli.request import length_text
from cubicsplat_cli.scene.paint import Rgba, mean_fill
from cubicsplat_cli.svg.drawing_reader import fill_of
from cubicsplat_cli.svg.markup import empty_document, titled
from cubicsplat_cli.svg.own import GEOMETRY, REFERENCE, GradientReader, OwnElement, own_elements

# The margin around the picture, in longer sides; the radius of a mark, its arms and its line width, in margins.
_MARGIN, _RADIUS, _ARM, _LINE = 1.0 / 16.0, 0.2, 0.4, 0.02


def layers(svg: str | bytes) -> dict[str, str]:
    """Return the SVG of each colour of a cutout by names such as `01-ff8800`, in the order in which they are drawn.

    All have the size of the picture and a margin with a register mark at each corner, so together they show the
    picture. A gradient is a layer, named by its mean colour. Each holds the mark of the SVG. Raises InputError for an
    SVG that cubicsplat did not write.
    """
    text = svg.encode() if isinstance(svg, str) else svg
    elements = own_elements(text)
    width, height = elements[0].canvas_size()
    margin = max(1, round(_MARGIN * max(width, height)))
    gradients = GradientReader(elements)
    root = fromstring(text)
    definitions: dict[str, Element] = {}
    by_paint: dict[tuple[str, str], tuple[Rgba, list[Element]]] = {}
    for parsed, element in zip(elements, root.iter(), strict=True):
        element.tag = parsed.name
        fill, opacity = element.get("fill", ""), element.get("fill-opacity", "1")
        if "Gradient" in element.tag:
            definitions[f"url(#{element.get('id')})"] = element
        elif element.tag in GEOMETRY:
            with parsed.checked():
                by_paint.setdefault((fill, opacity), (_colour(parsed, gradients), []))[1].append(element)
    title, mark = root.findtext("title", ""), made_mark(sha256_of(text))
    made = {}
    for number, ((fill, _), (rgba, shapes)) in enumerate(by_paint.items(), start=1):
        colour = colour_group(rgba).partition("-")[2]
        layer = _layer_document(root, (width, height), margin)
        layer.extend(copy.deepcopy([definitions[fill], *shapes] if fill in definitions else shapes))
        layer.append(_register_marks(width, height, margin))
        sheet = titled(layer, f"{title}, {number} of {len(by_paint)}: #{colour}", mark)
        made[f"{number:0{len(str(max(10, len(by_paint))))}d}-{colour}"] = with_checksum(sheet)
    return made


def _colour(shape: OwnElement, gradients: GradientReader) -> Rgba:
    """Return the colour of a shape's fill, the mean of a gradient. Raises ValueError if it cannot be read."""
    reference = REFERENCE.fullmatch(shape.attributes.get("fill", ""))
    if reference is None:
        return fill_of(shape.attributes, "fill")
    return mean_fill(gradients.gradient(reference[1], (0.0, 0.0, 1.0, 1.0)))


def _layer_document(root: Element, size: tuple[int, int], margin: int) -> Element:
    """Return an empty document of the same scale for a picture of a size in px and its margin."""
    width, height = size
    across, down = width + 2 * margin, height + 2 * margin
    sheet = empty_document(across, down)
    sheet.set("viewBox", f"{-margin} {-margin} {across} {down}")
    for name, side, whole in (("width", width, across), ("height", height, down)):
        number = root.get(name, "").rstrip("min")  # in px, mm or in
        sheet.set(name, length_text(float(number) * whole / side, root.get(name, "").removeprefix(number)))
    return sheet


def _register_marks(width: int, height: int, margin: int) -> Element:
    """Return a black circle with a cross for each corner of the margin."""
    radius, arm = _RADIUS * margin, _ARM * margin
    data = ""
    for x in (-margin / 2.0, width + margin / 2.0):
        for y in (-margin / 2.0, height + margin / 2.0):
            data += f"M{x - arm:g} {y:g}h{2 * arm:g}M{x:g} {y - arm:g}v{2 * arm:g}M{x - radius:g} {y:g}"
            data += f"a{radius:g} {radius:g} 0 1 0 {2 * radius:g} 0a{radius:g} {radius:g} 0 1 0 {-2 * radius:g} 0z"
    pen = {"fill": "none", "stroke": "#000", "stroke-width": f"{_LINE * margin:g}"}
    return Element("path", {"id": "register", "d": data, **pen})
