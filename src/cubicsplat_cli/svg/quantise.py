"""The numbers of a scene as an SVG file holds them.

Coordinates are whole multiples of 10^-precision px, colours have 8 bits, opacities three decimals. All values except
gradients are integers until they are written. A curve may begin at another of its anchors, or run backwards, where that
is shorter to write.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.record import record
from cubicsplat_cli.scene import Scene, pack_rings, ring_slices
from cubicsplat_cli.scene.gradients import FLAT, LINEAR, RADIAL, Gradients, ends_of
from cubicsplat_cli.scene.paint import Gradient, LinearGradient, Stop, mean_fill, parameter, radial_of_frame
from cubicsplat_cli.settings import PRECISION, Mode, width_decimals
from cubicsplat_cli.svg.values import OPACITY_DECIMALS, OPAQUE

# Renderers store coordinates as 24.8 fixed point (cairo) or float32; no canvas is nearly this large.
MAX_COORDINATE = 4.0e6
_POWERS = 10 ** np.arange(1, 19, dtype=np.int64)
# px: longer lines or axes look like one colour, and cairo's numbers end not far beyond.
_LONGEST = 16_000.0


@record
class GridScene:
    """A scene in integers, index 0 the front.

    points: (N, K, 2) int64, multiples of 10^-precision px. colours: (N, 3) int64 in 0..255. opacities: (N,) int64 in
    0..1000, thousandths. stroke_widths: (N,) int64, multiples of 10^-width_decimals px (the full width; 0 for closed).
    ring_ends: (N, R) int32 as in `Scene`, or None if all curves are one ring of one length; the padding of `points` is
    zero. gradients: of each curve, None if it is flat, in px and not yet rounded. If the opacities of its stops differ,
    they replace that of the curve, which is 1 then.
    """

    precision: int
    points: np.ndarray
    colours: np.ndarray
    opacities: np.ndarray
    stroke_widths: np.ndarray
    ring_ends: np.ndarray | None
    gradients: list[Gradient | None]

    @property
    def one_opacity(self) -> bool:
        """True if several curves all have one opacity, which the file gives once."""
        return len(self.opacities) > 1 and bool((self.opacities == self.opacities[0]).all())


def to_grid(scene: Scene, precision: int) -> GridScene:
    """Round a scene to the numbers of a file with `precision` decimals.

    Raises InputError, with the first curve, for a value not finite or out of range; UsageError for a bad precision.
    """
    PRECISION.check("precision", precision)
    scene.validate()
    scene = scene.as_numpy()
    points, ring_ends = scene.points, None
    if scene.ring_ends is not None:
        # Padding becomes zero, and empty rings between others vanish, as in a scene from a file.
        points, ring_ends = pack_rings(scene.mode, [scene.rings(curve) for curve in range(scene.curves)])
    _refuse(np.abs(points) > MAX_COORDINATE, f"control points lie more than {MAX_COORDINATE:.0f} px from the origin")
    _refuse(scene.half_widths > MAX_COORDINATE, f"half-width exceeds {MAX_COORDINATE:.0f} px")
    gradients, colours, opacities = paints_of(scene, precision)
    return GridScene(
        precision=precision,
        points=_shortest(scene.mode, _round(points, 10**precision), ring_ends),
        colours=_round(colours, 255),
        opacities=_round(opacities, 10**OPACITY_DECIMALS),
        stroke_widths=_round(2.0 * scene.half_widths, 10 ** width_decimals(precision)),
        ring_ends=ring_ends,
        gradients=gradients,
    )


def _round(values: np.ndarray, scale: int) -> np.ndarray:
    return np.rint(values.astype(np.float64) * float(scale)).astype(np.int64)


def _refuse(bad: np.ndarray, what: str) -> None:
    if bad.any():
        raise InputError(f"curve {int(np.argwhere(bad)[0][0])} cannot be written as SVG: its {what}")


def _shortest(mode: Mode, points: np.ndarray, ring_ends: np.ndarray | None) -> np.ndarray:
    """Return control points of the same picture that are shorter to write; changes those given."""
    closed = mode is Mode.CLOSED
    if ring_ends is None:
        return _shortest_description(points, closed)
    for curve, rings in enumerate(ring_slices(ring_ends, closed=closed)):
        for ring in rings:
            # A hole runs against the ring around it, so one ring of several must keep its direction.
            own = points[curve, None, ring]
            points[curve, ring] = (_shortest_description(own, closed) if len(rings) == 1 else _best_start(own))[0]
    return points


def _shortest_description(points: np.ndarray, closed: bool) -> np.ndarray:
    """Return each curve (N, K, 2) int64 in the direction and from the anchor that are shortest to write.

    The picture stays the same, since the nonzero rule ignores the direction and round caps are alike.
    """
    backwards = np.concatenate([points[:, :1], points[:, :0:-1]], axis=1) if closed else points[:, ::-1]
    if closed:
        points, backwards = _best_start(points), _best_start(backwards)
    shorter = _length_of_text(backwards, closed) < _length_of_text(points, closed)
    return np.where(shorter[:, None, None], backwards, points)


def _best_start(rings: np.ndarray) -> np.ndarray:
    """Return each ring from the first of the anchors with the shortest text on."""
    anchors, handles = rings[:, ::3], rings[:, 1::3]
    # A minus after a letter takes a character; elsewhere it saves the space.
    signs = (anchors[..., 0] < 0).astype(np.int64) + (handles[..., 0] < anchors[..., 0])
    first = 3 * (_digits(anchors).sum(-1) + signs).argmin(-1)
    order = (first[:, None] + np.arange(rings.shape[1])) % rings.shape[1]
    return np.take_along_axis(rings, order[..., None], axis=1)


def _length_of_text(points: np.ndarray, closed: bool) -> np.ndarray:
    """Return the characters (N,) of the path data, every cubic in its shorter form, less those that all curves have."""
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
    """Decimals of gradients' coordinates in px: one less, since a change of colour is less visible than an edge."""
    return max(0, precision - 1)


def paints_of(scene: Scene, precision: int) -> tuple[list[Gradient | None], np.ndarray, np.ndarray]:
    """Return the gradient of each curve in px, None if it is flat, and all colours (N, 3) and opacities (N,).

    Offsets have three decimals and fills 8 bits; coordinates are not yet rounded. The opacity of a curve multiplies
    those of its stops; where the products are equal they become the opacity of the curve. A gradient that nobody can
    tell from one colour becomes flat. scene: of numpy arrays. precision: decimals of the file's points.
    """
    given, colours, opacities = scene.gradients, scene.colours.astype(np.float64), scene.opacities.astype(np.float64)
    paints: list[Gradient | None] = [None] * scene.curves
    if given is None:
        return paints, colours, opacities
    given = given.changed(lambda t: t if t.dtype == np.int32 else t.astype(np.float64))
    step = 10.0 ** -gradient_decimals(precision)
    for curve in np.flatnonzero(given.kinds != FLAT).tolist():
        middle = np.concatenate(scene.rings(curve)).astype(np.float64).mean(axis=0)
        gradient = _in_px(given, curve, middle, step, float(opacities[curve]))
        t, stops = parameter(given.frames[curve], given.kinds[curve] == RADIAL, *middle), slice(given.counts[curve])
        paint = [np.interp(t, given.offsets[curve, stops], channel) for channel in given.stops[curve, stops].T]
        alike = gradient is None or len({stop.colour[3] for stop in gradient.stops}) == 1
        # The rounded fills have 8 bits, an opacity three decimals.
        opacities[curve] = opacities[curve] * paint[3] if alike else 1.0
        colours[curve] = paint[:3]
        if gradient is None or len({stop.colour for stop in gradient.stops}) == 1:
            continue
        if alike:
            gradient = replace(gradient, stops=tuple(Stop(s.offset, (*s.colour[:3], OPAQUE)) for s in gradient.stops))
        paints[curve] = gradient
        colours[curve] = np.array(mean_fill(gradient)[:3]) / OPAQUE
    return paints, colours, opacities


def _in_px(given: Gradients, curve: int, middle: np.ndarray, step: float, opacity: float) -> Gradient | None:
    """Return the gradient of one curve, None if it looks like one colour.

    middle: (2,) of the curve, px. step: of the coordinates in the file, px. opacity: of the curve.
    """
    count = int(given.counts[curve])
    offsets = given.offsets[curve, :count].round(OPACITY_DECIMALS).tolist()
    fills = np.rint(given.stops[curve, :count] * [1.0, 1.0, 1.0, opacity] * OPAQUE).astype(int).tolist()
    stops = tuple(Stop(offset, (r, g, b, alpha)) for offset, (r, g, b, alpha) in zip(offsets, fills, strict=True))
    frame = given.frames[curve]
    return _linear(frame, middle, step, stops) if given.kinds[curve] == LINEAR else _radial(frame, step, stops)


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
    gradient = radial_of_frame(frame, 1.0, stops)
    if max(gradient.rx, abs(gradient.cx), abs(gradient.cy)) > _LONGEST or gradient.ry < step:
        return None
    return gradient
