"""Areas in several gradients, one above the other, as a fill with gradients that fade out over it.

Where a colour c covers a share a of what lies below, b, a picture shows b + a (c - b). The lines from b to the shown
colours meet at c. That tells a at each pixel, to which a gradient is fitted. Gradients are added one by one, above or
below those found before, and each is fitted anew to what the others leave of the picture.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from itertools import chain

import numpy as np

from cubicsplat_cli.artwork.channels import largest, summed
from cubicsplat_cli.artwork.gradients.areas import EXPLAINED, MOST_TRIES, beside
from cubicsplat_cli.artwork.gradients.parts import LARGE_AREA, LEAST_AREA, Part, Parts
from cubicsplat_cli.artwork.gradients.shade import CLOSE, Ramp, Shade, ShadedArea, covered, shown
from cubicsplat_cli.artwork.gradients.shades import MOST_PIXELS, refitted, shade_of
from cubicsplat_cli.artwork.regions.fills import FLAT_RANGE, OPAQUE, SEEN
from cubicsplat_cli.progress import work
from cubicsplat_cli.raster import ndimage
from cubicsplat_cli.raster.shades import Pixels
from cubicsplat_cli.record import record
from cubicsplat_cli.scene.paint import laid_over

MOST_FAILED = 2  # of the largest parts of a picture, after which no others are tried, of up to a second each
MOST_LAYERS = 4
LEAST_PART = 0.5  # of its part of what is left that each layer explains, if as many as there may be will do
FAR = 4.0 * CLOSE  # levels by which a pixel shows that a gradient is missing, and beyond which it counts no more
ROUNDINGS = 2.0  # times as much as from one gradient pixels may differ from several, each rounded
SHOWS = 0.25  # share of a colour that shows it through those above well enough
PAIRS, VOTERS = 256, 1000  # pairs of lines that may meet at a colour, and pixels that choose one
ALONG = 1e-5  # least weight of a colour's place along a line on which all pixels lie, since any place suits them
MOST_FITTED = 1 << 14  # pixels of a part to which gradients are fitted
STRIP = 8  # rows of the strips that stand for a larger part
ROUNDS, STEPS = 2, 20  # in which gradients are fitted anew one by one, and all at once
SETTLED, FINISHED = 0.9, 0.998  # of the errors, that a last round or a last step leaves
STEP, SLOPE = 0.01, 100.0  # px or levels, of derivatives; and px at which a slope counts as a length

Layers = tuple[Shade, ...]  # back to front; the first is opaque


def with_layers(parts: Parts, areas: list[ShadedArea], most: int = MOST_TRIES) -> list[ShadedArea]:
    """Return the areas of a picture's gradients with areas of several gradients where these explain a part of the
    picture that the others do not, or do not in fewer. parts, areas, most: as of `gradient_areas`."""
    if len(parts.uneven(LEAST_AREA, FLAT_RANGE)) > most:
        return areas
    found, taken, failed = list[ShadedArea](), covered(areas, parts.numbers.shape), 0
    for number in parts.uneven(LARGE_AREA, FLAT_RANGE):
        part = parts.part(number)
        if part.pixels.values[:, 3].min() < OPAQUE:
            continue
        fill, even = part.plateau()
        few = len({area.shade for area in areas if area.patch.at(part.rows, part.columns).any()}) + bool(even.any())
        explained = (taken[part.rows, part.columns] | even).mean() >= EXPLAINED
        if explained and few <= 2:
            continue
        work().at()
        lowest = None if even.any() else _lowest(part)
        layers = _layers_of(part, lowest or _even(fill))
        area = None if layers is None else ShadedArea(layers[0], part.patch, over=layers[1:])
        # A fill may explain most of a part, but not what changes in it.
        if area is None or (area.off(part.pixels)[~even] <= ROUNDINGS * CLOSE).mean() < EXPLAINED:
            failed += 1
        elif area.over and not (explained and len(area.shades) > few):
            found.append(_extended(parts, part, area))
        if failed == MOST_FAILED:
            break
    if not found:
        return areas
    left = ~covered(found, parts.numbers.shape)
    # Of an area in which the part was, a rim may be left.
    return [new for old in areas if 2 * (new := old.kept(left)).patch.size > old.patch.size] + found


def _extended(parts: Parts, part: Part, area: ShadedArea) -> ShadedArea:
    """Return the area of a part in several gradients with the parts that these explain too and that explained pixels
    connect with it: rounding of several gradients, one after the other, cuts parts up."""
    mask, numbers = part.within(area.off(part.pixels) <= SEEN).mask, parts.numbers[part.patch.window]
    outside = Part(parts.levels, replace(part.patch, mask=~part.patch.mask))
    explained = outside.within(area.off(outside.pixels) <= ROUNDINGS * CLOSE).mask
    count = numbers.max() + 1
    sizes, most = (np.bincount(numbers[where], minlength=count) for where in (outside.patch.mask, explained))
    whole = most >= EXPLAINED * sizes
    reached = ndimage.binary_propagation(mask, None, mask | (explained & ((numbers == 0) | whole[numbers])))
    added = reached & ((numbers > 0) | ndimage.holes_of(mask))
    return replace(area, patch=replace(part.patch, mask=mask | added))


def _layers_of(part: Part, lowest: Shade) -> Layers | None:
    """Return the gradients of an opaque part, one or more; None if a few do not explain it. lowest: about the first."""
    search = _Search(part)
    layers: Layers = (lowest,)
    share = search.explained(layers)
    while share < EXPLAINED and len(layers) < MOST_LAYERS:
        trials = [search.added(layers, place) for place in range(len(layers), 0, -1)]
        layers = search.refitted(min(trials, key=search.errors))
        before, share = share, search.explained(layers)
        if share < before + LEAST_PART * (EXPLAINED - before) / (MOST_LAYERS + 1 - len(layers)):
            return None
    if share < EXPLAINED:
        return None
    return tuple(_cut(layer, part.pixels) for layer in _together(layers, search.some))


def _cut(shade: Shade, pixels: Pixels) -> Shade:
    """Return a gradient without the parts of its ramp that no pixels show."""
    t, ramp = shade.t(pixels.x, pixels.y), shade.ramp
    least, most = max(float(t.min()), float(ramp.knots[0])), min(float(t.max()), float(ramp.knots[-1]))
    if most <= least:
        return shade
    knots = np.concatenate([[least], ramp.knots[(ramp.knots > least) & (ramp.knots < most)], [most]])
    return replace(shade, ramp=Ramp(knots, ramp.at(knots)).trimmed())


def _even(fill: np.ndarray) -> Shade:
    """Return a fill (4,) in levels as a gradient of one colour."""
    frame = np.array([[1.0, 0.0, 0.0, 0.0], [0.0] * 4])
    return Shade(frame, False, Ramp(np.array([0.0, 1.0]), np.stack([fill, fill])), 0)


def _lowest(part: Part) -> Shade | None:
    """Return the gradient that explains most of a part, of some places in it and two sizes; None if all are small."""
    found = list[Shade]()
    for near in chain(beside(part), beside(part, 0.5)):
        shade = shade_of(part.pixels.some(near)).extended()
        found.append(shade)
        if (explained := shade.explains(part.pixels)).sum() >= LEAST_AREA:
            found.append(shade_of(part.pixels.some(explained)).extended())
    return max(found, key=lambda each: int(each.explains(part.pixels).sum()), default=None)


@record
class Between:
    """What pixels show of a layer at one place among others. below: (n, 3) levels beneath it; change: (n, 3) levels by
    which it changes these; room: (n,) share of the pixel that those above leave."""

    pixels: Pixels
    below: np.ndarray
    change: np.ndarray
    room: np.ndarray

    def shares(self, colour: np.ndarray, off: float, index: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return the shares (..., n) that colours (..., 3) cover of pixels of an index (n,), and bool, true where these
        are on the line to the colour but for `off` levels."""
        way, change, seen = colour[..., None, :] - self.below[index], self.change[index], self.room[index] >= SHOWS
        square = np.maximum(summed(way * way), 1.0)
        share = summed(change * way) / square
        beyond = np.maximum(share - 1.0, -share) * np.sqrt(square)
        aside = largest(np.abs(change - share[..., None] * way)) * self.room[index]
        return share, seen & (aside <= off) & (beyond <= off)

    @cached_property
    def far(self) -> np.ndarray:
        """The numbers (n,) of the pixels that show the layer."""
        return np.flatnonzero((self.room >= SHOWS) & (largest(np.abs(self.change)) * self.room > FAR))

    def likeliest(self, draw: np.random.Generator) -> np.ndarray | None:
        """Return the colour (3,) at which most lines of PAIRS of far pixels meet; None if none do, or few are far."""
        if len(self.far) < LEAST_AREA:
            return None
        some = draw.choice(self.far, min(len(self.far), VOTERS), replace=False)
        both = draw.choice(some, (2, PAIRS))
        ways = self.change[both] / np.linalg.norm(self.change[both], axis=2, keepdims=True)
        across = np.eye(3) - ways[..., :, None] * ways[..., None, :]
        # Lines that are one line meet anywhere: there the colour as far as there are colours is as good as any.
        starts, way = self.below[both[0]], ways[0]
        room = np.where(way > 0.0, 255.0 - starts, starts)
        end = starts + (room / np.maximum(np.abs(way), 1e-6)).min(axis=1, keepdims=True) * way
        weight = ALONG * np.eye(3)
        sums = (across @ self.below[both][..., None]).sum(axis=0) + (weight @ end[..., None])
        colours = np.linalg.solve(across.sum(axis=0) + weight, sums)[..., 0]
        colours = colours[(np.abs(colours - 127.5) <= 127.5 + FAR).all(axis=1)].clip(0.0, 255.0)
        if len(colours) == 0:
            return None
        return colours[self.shares(colours, CLOSE, some)[1].sum(axis=1).argmax()]

    def gradient(self, colour: np.ndarray, off: float) -> Shade | None:
        """Return the gradient of about a colour (3,) that the pixels within `off` levels show; None if hardly any do.
        The colour is the one nearest to all lines, weighted by what pixels show of it, by Gauss and Newton's method."""
        for _ in range(4):
            share, on_line = self.shares(colour, off, self.far)
            if on_line.sum() < LEAST_AREA:
                return None
            way, share = (colour - self.below[self.far])[on_line], share[on_line]
            way = way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)
            across = np.eye(3) - way[:, :, None] * way[:, None, :]
            square = np.einsum("n,nij->ij", share**2, across) / len(share)
            step = np.einsum("n,nij,nj->i", share, across, self.change[self.far][on_line]) / len(share)
            colour = (colour + np.linalg.solve(square + ALONG * np.eye(3), step)).clip(0.0, 255.0)
        share, on_line = self.shares(colour, off, np.arange(len(self.room)))
        sizes = largest(np.abs(colour - self.below))
        visible = on_line & (sizes > FAR)
        if visible.sum() < LEAST_AREA:
            return None
        # Shares in levels, so that their errors are those of colours.
        scale = float(np.median(sizes[visible]))
        values = np.zeros((int(visible.sum()), 4))
        values[:, 3] = scale * share[visible].clip(0.0, 1.0)
        shade = shade_of(Pixels(self.pixels.x[visible], self.pixels.y[visible], values)).extended()
        knots, opacity = _within(shade.ramp.knots, shade.ramp.colours[:, 3] / scale)
        return replace(shade, ramp=Ramp(knots, opacity[:, None] * np.append(colour, 255.0)))


def _within(knots: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the knots (K,) and values (K,) of lines that end where those given leave 0 to 1."""
    slopes = np.diff(values)
    steep = np.flatnonzero(slopes)
    crossings = [knots[steep] + (end - values[steep]) / slopes[steep] * np.diff(knots)[steep] for end in (0.0, 1.0)]
    inside = [t[(t > knots[steep]) & (t < knots[steep + 1])] for t in crossings]
    every = np.unique(np.concatenate([knots, *inside]))
    return every, np.interp(every, knots, values).clip(0.0, 1.0)


def _between(below: Layers, above: Layers, pixels: Pixels) -> Between:
    """Return what pixels show of a layer between others."""
    base = shown(below, pixels)[:, :3]
    seen, room = _without(above, pixels)
    return Between(pixels, base, seen - base, room)


def _without(above: Layers, pixels: Pixels) -> tuple[np.ndarray, np.ndarray]:
    """Return the colours (n, 3) of pixels without the layers above, and the share (n,) of them that shows."""
    if not above:
        return pixels.values[:, :3], np.ones(len(pixels.x))
    over = shown(above, pixels)
    room = 1.0 - over[:, 3] / 255.0
    return (pixels.values - over)[:, :3] / np.maximum(room, SHOWS)[:, None], room


def _together(layers: Layers, pixels: Pixels) -> Layers:
    """Return gradients, all fitted to pixels at once by Levenberg's and Marquardt's method; outliers count little."""
    left, damping = pixels.values - shown(layers, pixels), 1e-3
    errors = float(_robust(left).sum())
    for _ in range(STEPS):
        numbers = [_numbers(layer) for layer in layers]
        change = np.concatenate(_changes(layers, numbers, pixels))
        weighted = (change / (1.0 + largest(np.abs(left)) ** 2 / FAR**2)[:, None] ** 2).reshape(len(change), -1)
        square, side = weighted @ change.reshape(len(change), -1).T, weighted @ left.ravel()
        step = np.linalg.solve(square + np.diag(damping * np.diag(square) + 1e-9), side)
        ends = np.cumsum([len(own) for own in numbers])[:-1]
        moved = [own + by for own, by in zip(numbers, np.split(step, ends), strict=True)]
        trial = tuple(map(_of_numbers, layers, moved))
        off = pixels.values - shown(trial, pixels)
        if (following := float(_robust(off).sum())) < errors:
            if following > FINISHED * errors:
                return trial
            layers, left, errors, damping = trial, off, following, 0.2 * damping
        else:
            damping *= 10.0
    return layers


def _robust(left: np.ndarray) -> np.ndarray:
    """Return (n,) squares of the levels (n, 4) by which pixels are off, FAR^2 at most, as Geman and McClure do."""
    square = largest(np.abs(left)) ** 2
    return square / (1.0 + square / FAR**2)


def _changes(layers: Layers, numbers: list[np.ndarray], pixels: Pixels) -> list[np.ndarray]:
    """Return for each gradient the derivatives (m, n, 4) of what pixels show by its numbers (m,)."""
    seen = [layer.at(pixels.x, pixels.y) for layer in layers]
    room, out = np.ones((len(pixels.x), 1)), list[np.ndarray]()
    for place in range(len(layers) - 1, -1, -1):
        layer, below = layers[place], laid_over(seen[:place], 255.0) if place else np.zeros(4)
        own = np.empty((len(numbers[place]), *seen[place].shape))
        for k in range(len(own)):
            moved = numbers[place].copy()
            moved[k] += STEP
            by = (_of_numbers(layer, moved).at(pixels.x, pixels.y) - seen[place]) / STEP
            own[k] = room * (by - by[:, 3:] / 255.0 * below)
        out.append(own)
        room = room * (1.0 - seen[place][:, 3:] / 255.0)
    return out[::-1]


def _numbers(shade: Shade) -> np.ndarray:
    """Return the numbers (m,) of a gradient that may vary: of its geometry, inner stops, colours and opacities, or the
    colours of an opaque one, all of about the size of one px or level."""
    knots, colours = shade.ramp.knots, shade.ramp.colours
    frame = shade.frame[: _rows(shade)]
    paint = [colours[:, :3].ravel()] if colours[:, 3].min() >= 255.0 else [_colour(shade), colours[:, 3]]
    return np.concatenate([SLOPE * frame[:, :2].ravel(), frame[:, 2], knots[1:-1], *paint])


def _rows(shade: Shade) -> int:
    """Return how many rows of the frame of a gradient may vary."""
    if shade.parameters == 0:
        return 0
    return 2 if shade.radial else 1


def _colour(shade: Shade) -> np.ndarray:
    """Return the colour (3,) in levels of a gradient of one colour and varying opacity."""
    strongest = shade.ramp.colours[shade.ramp.colours[:, 3].argmax()]
    return 255.0 * strongest[:3] / max(float(strongest[3]), 1.0)


def _of_numbers(shade: Shade, numbers: np.ndarray) -> Shade:
    """Return a gradient with other numbers, as of `_numbers`."""
    frame, count, knots, rows = shade.frame.copy(), len(shade.ramp.knots), shade.ramp.knots.copy(), _rows(shade)
    turn, middle, inner, paint = np.split(numbers, [2 * rows, 3 * rows, 3 * rows + count - 2])
    frame[:rows, :2], frame[:rows, 2] = turn.reshape(rows, 2) / SLOPE, middle
    knots[1:-1] = np.maximum.accumulate(np.clip(inner, knots[0], knots[-1]))
    if shade.ramp.colours[:, 3].min() >= 255.0:
        colours = np.column_stack([paint.reshape(count, 3), np.full(count, 255.0)])
    else:
        opacity = paint[3:, None].clip(0.0, 255.0)
        colours = opacity / 255.0 * np.append(paint[:3].clip(0.0, 255.0), 255.0)
    return replace(shade, frame=frame, ramp=Ramp(knots, colours))


class _Search:
    """The search for the gradients of a part."""

    def __init__(self, part: Part) -> None:
        self.draw = np.random.default_rng(0)
        # Slopes show in neighbouring pixels, so that strips stand for a large part.
        strips = -(-len(part) // MOST_FITTED)
        self.pixels = part.pixels.some(part.rows // STRIP % strips == 0)
        count = len(self.pixels.x)
        self.some = self.pixels.some(self.draw.choice(count, min(count, MOST_PIXELS), replace=False))
        self.few = self.some.some(np.arange(min(len(self.some.x), VOTERS)))

    def off(self, layers: Layers) -> np.ndarray:
        """Return (n,) levels by which some of the pixels differ from gradients."""
        return largest(np.abs(shown(layers, self.some) - self.some.values))

    def errors(self, layers: Layers) -> float:
        """Return the mean square of these levels, of which each is FAR at most."""
        return float((np.minimum(self.off(layers), FAR) ** 2).mean())

    def explained(self, layers: Layers) -> float:
        """Return the share of these pixels that gradients explain."""
        return float((self.off(layers) <= CLOSE).mean())

    def added(self, layers: Layers, place: int) -> Layers:
        """Return gradients with one more at a place among them; the same if no pixels show it."""
        between = _between(layers[:place], layers[place:], self.pixels)
        colour = between.likeliest(self.draw)
        one = None if colour is None else between.gradient(colour, CLOSE)
        return layers if one is None else (*layers[:place], one, *layers[place:])

    def refitted(self, layers: Layers) -> Layers:
        """Return gradients, each fitted again and again to what the others leave of the pixels."""
        errors = self.errors(layers)
        for _ in range(ROUNDS if len(layers) > 1 else 0):
            for place in range(len(layers)):
                others = self._lowest(layers) if place == 0 else self._upper(layers, place)
                trials = [(*layers[:place], one, *layers[place + 1 :]) for one in others]
                layers = min([layers, *trials], key=self.errors)
            layers = _together(layers, self.few)
            before, errors = errors, self.errors(layers)
            if errors > SETTLED * before:
                break
        return layers

    def _lowest(self, layers: Layers) -> list[Shade]:
        """Return gradients that may stand in place of the first one."""
        seen, room = _without(layers[1:], self.pixels)
        clear = room >= 2.0 * SHOWS
        if layers[0].parameters == 0 or clear.sum() < LEAST_AREA:
            return []
        colours = np.column_stack([seen, self.pixels.values[:, 3]])
        left = Pixels(self.pixels.x, self.pixels.y, colours).some(clear)
        return [refitted(layers[0], left).extended(), shade_of(left).extended()]

    def _upper(self, layers: Layers, place: int) -> list[Shade]:
        """Return gradients that may stand in place of another one."""
        between = _between(layers[:place], layers[place + 1 :], self.pixels)
        trials = [between.gradient(_colour(layers[place]), FAR)]
        if (fresh := between.likeliest(self.draw)) is not None:
            trials.append(between.gradient(fresh, CLOSE))
        return [trial for trial in trials if trial is not None]
