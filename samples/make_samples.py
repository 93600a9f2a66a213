"""Write the pictures of this folder again: `python samples/make_samples.py` with the package installed.

The drawings are ours, written below as SVG and rendered by cairosvg; the photos come with scikit-image.
There is no randomness: the same versions of cairo and Pillow give the same bytes.
"""

from __future__ import annotations

import io
import math
from pathlib import Path

import cairosvg
import skimage.data
from PIL import Image

FOLDER = Path(__file__).resolve().parent


def polygon(points: list[tuple[float, float]], fill: str) -> str:
    path = " ".join(f"{x:.2f},{y:.2f}" for x, y in points)
    return f'<polygon points="{path}" fill="{fill}"/>'


def ridge(base: float, waves: list[tuple[float, float, float]], fill: str, floor: float) -> str:
    """A mountain ridge: a sum of sharpened sines (height, wavelength, phase), closed down to `floor`."""
    top = [
        (x, base - sum(h * (1 - abs(math.sin(math.pi * x / length + phase))) for h, length, phase in waves))
        for x in range(-4, 517, 4)
    ]
    return polygon([*top, (516, floor), (-4, floor)], fill)


def pine(x: float, foot: float, height: float, fill: str) -> str:
    """A pine of three stacked triangles and a trunk."""
    parts = [
        f'<rect x="{x - height * 0.035:.2f}" y="{foot - height * 0.16:.2f}" width="{height * 0.07:.2f}" '
        f'height="{height * 0.18:.2f}" fill="#3a2a2c"/>'
    ]
    for top, bottom, half in ((0.42, 0.12, 0.27), (0.70, 0.32, 0.21), (1.0, 0.56, 0.15)):
        corners = [(x, foot - top * height), (x + half * height, foot - bottom * height)]
        corners.append((x - half * height, foot - bottom * height))
        parts.append(polygon(corners, fill))
    return "".join(parts)


def cloud(x: float, y: float, scale: float, opacity: float) -> str:
    lobes = ((-30, 2, 18, 9), (-12, -6, 20, 14), (12, -3, 22, 12), (34, 3, 17, 8), (2, 5, 44, 8))
    ellipses = "".join(f'<ellipse cx="{dx}" cy="{dy}" rx="{rx}" ry="{ry}"/>' for dx, dy, rx, ry in lobes)
    place = f"translate({x} {y}) scale({scale})"
    return f'<g fill="#fff1e0" opacity="{opacity}" transform="{place}">{ellipses}</g>'


def landscape() -> str:
    """An evening by a mountain lake: gradients, flat shapes, soft and sharp edges, 512 x 384."""
    glints = "".join(
        f'<ellipse cx="{352 + 14 * math.sin(2.3 * i):.2f}" cy="{262 + 9 * i}" rx="{34 - 2.6 * i:.2f}" '
        f'ry="1.6" fill="#ffe9b0" opacity="{0.8 - 0.06 * i:.2f}"/>'
        for i in range(9)
    )
    pines = "".join(
        pine(x, foot, height, fill)
        for x, foot, height, fill in (
            (20, 352, 150, "#173b3f"), (64, 362, 118, "#1d4a49"), (104, 372, 86, "#245653"),
            (494, 356, 132, "#173b3f"), (452, 366, 100, "#1d4a49"), (418, 374, 66, "#245653"),
        )
    )  # fmt: skip
    birds = "".join(
        f'<path d="M{x} {y} q{s * 0.5} {-s * 0.55} {s} 0 q{s * 0.5} {-s * 0.55} {s} 0" fill="none" '
        f'stroke="#3d3550" stroke-width="2" stroke-linecap="round"/>'
        for x, y, s in ((150, 84, 11), (182, 70, 8), (204, 90, 9))
    )
    return f"""<svg xmlns="http://www.w3.org/2000/svg" width="512" height="384" viewBox="0 0 512 384">
<defs>
<linearGradient id="sky" x1="0" y1="0" x2="0" y2="1">
<stop offset="0" stop-color="#2b3a77"/><stop offset=".45" stop-color="#c2628a"/>
<stop offset=".8" stop-color="#f8a25f"/><stop offset="1" stop-color="#ffd98a"/></linearGradient>
<linearGradient id="lake" x1="0" y1="0" x2="0" y2="1">
<stop offset="0" stop-color="#f0a274"/><stop offset=".4" stop-color="#8a5f8f"/>
<stop offset="1" stop-color="#23305e"/></linearGradient>
<radialGradient id="glow"><stop offset="0" stop-color="#fff3c4" stop-opacity=".95"/>
<stop offset="1" stop-color="#ffd98a" stop-opacity="0"/></radialGradient>
</defs>
<rect width="512" height="256" fill="url(#sky)"/>
<circle cx="352" cy="178" r="96" fill="url(#glow)"/><circle cx="352" cy="178" r="34" fill="#fff0b8"/>
{cloud(108, 128, 1.15, 0.55)}{cloud(436, 78, 0.9, 0.45)}{cloud(250, 52, 0.7, 0.35)}{birds}
{ridge(216, [(70, 210, 0.4), (22, 74, 1.1)], "#8f5a8c", 258)}
{ridge(236, [(58, 150, 1.3), (16, 52, 0.2)], "#5d4478", 258)}
{ridge(252, [(30, 118, 0.1), (10, 40, 0.9)], "#3a3360", 258)}
<rect y="256" width="512" height="128" fill="url(#lake)"/>
<g opacity=".35" transform="matrix(1 0 0 -0.5 0 384)">{ridge(252, [(58, 150, 1.3)], "#3a3360", 258)}</g>
{glints}
<path d="M-4 330 C70 306 150 352 232 362 S400 340 516 326 V388 H-4 Z" fill="#2c5f57"/>
<path d="M-4 352 C90 338 170 372 262 374 S430 360 516 350 V388 H-4 Z" fill="#1c4347"/>
{pines}
</svg>"""


def logo() -> str:
    """A mark of curves in four flat colours with a hole, transparent outside, 256 x 256."""
    return """<svg xmlns="http://www.w3.org/2000/svg" width="256" height="256" viewBox="0 0 256 256">
<path fill="#14746f" fill-rule="evenodd" d="M128 14 C160 62 226 92 226 150 C226 204 182 244 128 244
 C74 244 30 204 30 150 C30 92 96 62 128 14 Z
 M128 100 C97 100 74 123 74 152 C74 181 98 204 128 204 C158 204 182 181 182 152 C182 123 159 100 128 100 Z"/>
<path fill="#f2545b" d="M34 176 C60 226 150 238 204 196 C228 177 240 146 232 112
 C228 152 206 184 168 198 C124 214 72 206 34 176 Z"/>
<path fill="#ffc145" d="M128 124 C146 124 157 136 157 152 C157 168 145 180 128 180 C134 170 138 163 138 152
 C138 141 134 132 128 124 Z"/>
<circle cx="204" cy="50" r="20" fill="#22335c"/>
</svg>"""


def render(svg: str, mode: str) -> Image.Image:
    return Image.open(io.BytesIO(cairosvg.svg2png(bytestring=svg.encode()))).convert(mode)


def main() -> None:
    Image.fromarray(skimage.data.astronaut()).save(FOLDER / "astronaut.jpg", quality=92, subsampling=0)
    Image.fromarray(skimage.data.chelsea()).save(FOLDER / "chelsea.png", optimize=True)
    render(landscape(), "RGB").save(FOLDER / "landscape.png", optimize=True)
    render(logo(), "RGBA").save(FOLDER / "logo.png", optimize=True)
    for path in sorted(FOLDER.glob("*.[jp][pn]g")):
        with Image.open(path) as image:
            print(f"{path.name}: {image.width} x {image.height} {image.mode}, {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()
