"""The numbers of a scene as an SVG file can hold them.

Coordinates are whole multiples of 10^-precision px, colours have 8 bits, opacities three decimals. Everything
but gradients is an integer until the very end, so the writer, `quantise_scene` and the reader agree to the last bit. A
curve may begin at another of its anchors, or run backwards, where that is shorter to write.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene, pack_rings
from cubicsplat_cli.scene.arrays import Array, as_numpy
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, Gradients, ends_of, gradients_of, paint_at
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, RadialGradient, Stop, mean_fill, radial_from
from cubicsplat_cli.settings import PRECISION, Mode
from cubicsplat_cli.svg.values import levels_of, unit_colour

OPACITY_DECIMALS = 3  # and of a gradient's focus in the unit circle
# Whole pixels would make most strokes 0 or 1 px wide, so widths keep two decimals at least.
MIN_WIDTH_DECIMALS = 2
# Renderers store coordinates as 24.8 fixed point (cairo) or float32; nothing near this is on any canvas.
MAX_COORDINATE = 4.0e6
_POWERS = 10 ** np.arange(1, 19, dtype=np.int64)
_OPAQUE = 255
_OFFSETS = 1000  # three decimals
# px: of a longer line or axis nothing is seen, and cairo's numbers end not far from it.
_LONGEST = 16_000.0
_DECIMALS = 7  # more than any file has


@record
class GridScene:
    """A scene in integers.

    points: (N, K, 2) int64, multiples of 10^-precision px. colours: (N, 3) int64 in 0..255. opacities: (N,)
    int64 in 0..1000, thousandths. stroke_widths: (N,) int64, multiples of 10^-width_decimals px (the full
    width; 0 for closed). background: three integers in 0..255, or None. ring_ends: (N, R) int32 or None, as in
    `Scene`, but None wherever all curves are one ring of one length, and the padding of `points` is zero. gradients: of
    each curve, None where it is flat, in px and not yet rounded (`as_written` rounds them); the stops' opacities count
    instead of the curve's where they differ, which then is 1.
    """

    mode: Mode
    width: int
    height: int
    precision: int
    points: np.ndarray
    colours: np.ndarray
    opacities: np.ndarray
    stroke_widths: np.ndarray
    background: tuple[int, int, int] | None
    ring_ends: np.ndarray | None = None
    gradients: tuple[Gradient | None, ...] = ()

    @property
    def width_decimals(self) -> int:
        """Decimals of the stroke widths."""
        return max(self.precision, MIN_WIDTH_DECIMALS)

    @property
    def one_opacity(self) -> bool:
        """Whether several curves all have one opacity, to be said once."""
        return len(self.opacities) > 1 and bool((self.opacities == self.opacities[0]).all())


def check_precision(precision: int) -> None:
    """Raise UsageError unless `precision` is a whole number in 0..6."""
    PRECISION.check("precision", precision)


def to_grid(scene: Scene, precision: int) -> GridScene:
    """Round `scene` to what a file with `precision` decimals holds.

    Raises InputError that names the first curve with a value that is not finite or lies out of range;
    UsageError for a precision outside 0..6.
    """
    check_precision(precision)
    scene.validate()
    points, ring_ends = _packed(scene)
    half_widths = _array(scene.half_widths)
    _refuse(np.abs(points) > MAX_COORDINATE, f"control points lie more than {MAX_COORDINATE:.0f} px from the origin")
    _refuse(half_widths > MAX_COORDINATE, f"half-width exceeds {MAX_COORDINATE:.0f} px")
    width_decimals = max(precision, MIN_WIDTH_DECIMALS)
    gradients, colours, opacities = paints_of(scene, precision)
    return GridScene(
        mode=scene.mode,
        width=scene.width,
        height=scene.height,
        precision=precision,
        points=_shortest(scene.mode, _round(points, 10**precision), ring_ends),
        colours=_round(_array(colours), 255),
        opacities=_round(_array(opacities), 10**OPACITY_DECIMALS),
        stroke_widths=_round(2.0 * half_widths, 10**width_decimals),
        background=levels_of(scene.background),
        ring_ends=ring_ends,
        gradients=tuple(gradients) if any(gradients) else (),
    )


def _packed(scene: Scene) -> tuple[np.ndarray, np.ndarray | None]:
    """Points and ring ends in the one form that a file gives back: padding is zero, no empty ring between others."""
    if scene.ring_ends is None:
        return _array(scene.points), None
    points, ring_ends = pack_rings(scene.mode, [scene.rings(curve) for curve in range(scene.curves)])
    return _array(points), None if ring_ends is None else as_numpy(ring_ends)


def _shortest(mode: Mode, points: np.ndarray, ring_ends: np.ndarray | None) -> np.ndarray:
    closed = mode is Mode.CLOSED
    if ring_ends is None:
        return shortest_description(points, closed=closed)
    result = points.copy()
    for curve, rings in enumerate(ring_slices(ring_ends, closed=closed)):
        for ring in rings:
            # Rings turn against each other where one is a hole: none may be turned round alone.
            one = shortest_description(points[curve, None, ring], closed=closed, turn=len(rings) == 1)
            result[curve, ring] = one[0]
    return result


def quantise_scene(scene: Scene, precision: int) -> Scene:
    """The scene exactly as the file with `precision` decimals says it: equals `read_svg(write_svg(scene))`.

    Raises InputError as `to_grid` does, UsageError for a precision outside 0..6.
    """
    grid = to_grid(scene, precision)
    return Scene(
        mode=grid.mode,
        width=grid.width,
        height=grid.height,
        points=(grid.points / 10.0**grid.precision).astype(np.float32),
        colours=(grid.colours / 255.0).astype(np.float32),
        opacities=(grid.opacities / 10.0**OPACITY_DECIMALS).astype(np.float32),
        half_widths=(grid.stroke_widths / 10.0**grid.width_decimals / 2.0).astype(np.float32),
        background=unit_colour(grid.background),
        ring_ends=grid.ring_ends,
        gradients=gradients_of([g and as_written(g, grid.precision) for g in grid.gradients]),
    )


def _array(values: Array) -> np.ndarray:
    return as_numpy(values).astype(np.float64)


def _round(values: np.ndarray, scale: int) -> np.ndarray:
    return np.rint(values * float(scale)).astype(np.int64)


def _refuse(bad: np.ndarray, what: str) -> None:
    if bad.any():
        curve = int(np.argwhere(bad)[0][0])
        raise InputError(f"curve {curve} cannot be written as SVG: its {what}")


def ring_slices(ring_ends: np.ndarray, *, closed: bool) -> list[list[slice]]:
    """The slices of its control points that each ring of each curve has; ring_ends (N, R) as in `Scene`."""
    shared = 0 if closed else 1
    rows = [[0, *row] for row in ring_ends.tolist()]
    return [[slice(3 * a, 3 * b + shared) for a, b in itertools.pairwise(row) if a < b] for row in rows]


def shortest_description(points: np.ndarray, *, closed: bool, turn: bool = True) -> np.ndarray:
    """(N, K, 2) int64 control points of the same curves, each in the direction and from the anchor that are shortest to
    write. The picture stays the same: the nonzero rule ignores the direction, and round caps are alike.

    turn: whether a curve may be run through backwards; one ring of several may not.
    """
    if not turn:
        return _best_start(points)
    backwards = np.concatenate([points[:, :1], points[:, :0:-1]], axis=1) if closed else points[:, ::-1]
    if closed:
        points, backwards = _best_start(points), _best_start(backwards)
    shorter = _length_of_text(backwards, closed) < _length_of_text(points, closed)
    return np.where(shorter[:, None, None], backwards, points)


def _best_start(rings: np.ndarray) -> np.ndarray:
    """Each ring turned so that it begins at the anchor with the shortest text, the first of them."""
    anchors, handles = rings[:, ::3], rings[:, 1::3]
    # A minus right after a letter is one more; elsewhere it saves the space.
    signs = (anchors[..., 0] < 0).astype(np.int64) + (handles[..., 0] < anchors[..., 0])
    first = 3 * (_digits(anchors).sum(-1) + signs).argmin(-1)
    order = (first[:, None] + np.arange(rings.shape[1])) % rings.shape[1]
    return np.take_along_axis(rings, order[..., None], axis=1)


def _length_of_text(points: np.ndarray, closed: bool) -> np.ndarray:
    """(N,) characters of each curve's path data, every cubic in its shorter form, but for what all have alike."""
    per_curve = points.shape[1]
    starts = 3 * np.arange(per_curve // 3)
    ends = starts[:, None] + np.array([1, 2, 3])
    absolute = points[:, ends % per_curve if closed else ends]
    relative = absolute - points[:, starts][:, :, None]
    cubics = np.minimum(_digits(absolute).sum((-1, -2)), _digits(relative).sum((-1, -2))).sum(-1)
    signs = (points[:, 0, 0] < 0).astype(np.int64) + (relative[:, 0, 0, 0] < 0)
    return cubics + _digits(points[:, 0]).sum(-1) + signs


def _digits(values: np.ndarray) -> np.ndarray:
    return 1 + np.searchsorted(_POWERS, np.abs(values), side="right")


def gradient_decimals(precision: int) -> int:
    """Decimals of gradients' coordinates in px: where a colour changes is seen less than where a shape ends."""
    return max(0, precision - 1)


def paints_of(scene: Scene, precision: int) -> tuple[list[Gradient | None], np.ndarray, np.ndarray]:
    """The gradient of each curve in px, None where it is flat, and all colours (N, 3) and opacities (N,).

    Offsets have three decimals, fills 8 bits; coordinates are yet to be rounded. A curve's opacity goes into its stops,
    and comes back from them where they are alike; what nobody can tell from one colour becomes one. precision:
    decimals of the file's points.
    """
    scene = scene.as_numpy()
    given, colours, opacities = scene.gradients, scene.colours.astype(np.float64), scene.opacities.astype(np.float64)
    paints: list[Gradient | None] = [None] * scene.curves
    if given is None:
        return paints, colours, opacities
    given = given.floating(lambda t: t.astype(np.float64))
    step = 10.0 ** -gradient_decimals(precision)
    for curve in np.flatnonzero(given.kinds != FLAT).tolist():
        middle = np.concatenate(scene.rings(curve)).astype(np.float64).mean(axis=0)
        gradient = _in_px(given, curve, middle, step, float(opacities[curve]))
        paint = paint_at(given, curve, middle)
        alike = gradient is None or len({stop.colour[3] for stop in gradient.stops}) == 1
        # Not from the rounded fills: an opacity has three decimals.
        opacities[curve] = opacities[curve] * paint[3] if alike else 1.0
        colours[curve] = paint[:3]
        if gradient is None or len({stop.colour for stop in gradient.stops}) == 1:
            continue
        if alike:
            gradient = replace(gradient, stops=tuple(Stop(s.offset, (*s.colour[:3], _OPAQUE)) for s in gradient.stops))
        paints[curve] = gradient
        colours[curve] = np.array(mean_fill(gradient)[:3]) / _OPAQUE
    return paints, colours, opacities


def _in_px(given: Gradients, curve: int, middle: np.ndarray, step: float, opacity: float) -> Gradient | None:
    """step: of the coordinates in the file, px."""
    count = int(given.counts[curve])
    offsets = np.rint(given.offsets[curve, :count] * _OFFSETS) / _OFFSETS
    values = given.stops[curve, :count] * np.array([1.0, 1.0, 1.0, opacity])
    fills = np.rint(values * _OPAQUE).astype(int).tolist()
    stops = tuple(
        Stop(offset, (red, green, blue, alpha))
        for offset, (red, green, blue, alpha) in zip(offsets.tolist(), fills, strict=True)
    )
    frame = given.frames[curve]
    if int(given.kinds[curve]) == LINEAR:
        return _linear(frame, middle, step, stops)
    return _radial(frame, step, stops)


def _linear(frame: np.ndarray, middle: np.ndarray, step: float, stops: tuple[Stop, ...]) -> Gradient | None:
    if float(np.linalg.norm(frame[0, :2])) * _LONGEST < 1.0:
        return None
    start, end = (place[0] for place in ends_of(frame[None], middle[None]))
    # A line that is shorter than a step would have no direction.
    end = start + (end - start) * max(1.0, 1.01 * step / np.abs(end - start).max())
    if max(np.abs(start).max(), np.abs(end).max()) > _LONGEST:
        return None
    return LinearGradient(float(start[0]), float(start[1]), float(end[0]), float(end[1]), stops)


def _radial(frame: np.ndarray, step: float, stops: tuple[Stop, ...]) -> Gradient | None:
    if abs(float(np.linalg.det(frame[:, :2]))) * _LONGEST**2 < 1.0:
        return None
    inverse = np.linalg.inv(frame[:, :2])
    gradient = radial_from(np.column_stack([inverse, -inverse @ frame[:, 2]]), stops)
    if max(gradient.rx, abs(gradient.cx), abs(gradient.cy)) > _LONGEST or gradient.ry < step:
        return None
    return gradient


def as_written(gradient: Gradient, precision: int) -> Gradient:
    """A gradient as a file of this precision holds it, in px; see `gradient_element`."""
    steps = 10.0 ** gradient_decimals(precision)

    def rounded(value: float) -> float:
        return round(value * steps) / steps

    if isinstance(gradient, RadialGradient) and rounded(gradient.rx) != rounded(gradient.ry):
        matrix, focus = np.rint(gradient.matrix() * steps) / steps, gradient.focus
        if focus is not None:
            x, y = (matrix @ (*np.round(gradient.unit_focus(), OPACITY_DECIMALS), 1.0)).tolist()
            focus = x, y
        return without_noise(radial_from(matrix, gradient.stops, focus))
    return without_noise(_with_lengths(gradient, rounded))


def without_noise(gradient: Gradient) -> Gradient:
    """A gradient read from a file, its coordinates without the noise of rounding."""
    plain = _with_lengths(gradient, lambda value: round(value, _DECIMALS))
    return replace(plain, angle=0.0) if isinstance(plain, RadialGradient) and plain.rx == plain.ry else plain


def _with_lengths(gradient: Gradient, change: Callable[[float], float]) -> Gradient:
    names = ("x1", "y1", "x2", "y2") if isinstance(gradient, LinearGradient) else ("cx", "cy", "rx", "ry")
    lengths: dict[str, Any] = {name: change(getattr(gradient, name)) for name in names}
    if isinstance(gradient, RadialGradient) and gradient.focus is not None:
        lengths["focus"] = change(gradient.focus[0]), change(gradient.focus[1])
    return replace(gradient, **lengths)
