"""The scene: the parameters of N cubic Bezier shapes on a canvas, which fit, raster and svg exchange."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from cubicsplat_cli.errors import InputError
from cubicsplat_cli.scene.arrays import Array, CurveArrays, is_array, kind_of, like, namespace, padded, places_used
from cubicsplat_cli.scene.gradients import Gradients
from cubicsplat_cli.settings import Mode


def segments_from_points(mode: Mode, points_per_curve: int) -> int:
    """Return the number M of cubic segments of a curve with K control points: K = 3M (closed) or 3M + 1 (open).

    Raises InputError if no whole number of segments, at least one, has that many control points.
    """
    shared = 0 if mode is Mode.CLOSED else 1
    segments, rest = divmod(points_per_curve - shared, 3)
    if segments < 1 or rest:
        count = "3M + 1" if shared else "3M"
        raise InputError(f"{mode.value} curves need {count} control points for M >= 1 segments, not {points_per_curve}")
    return segments


def points_from_segments(mode: Mode, segments: int) -> int:
    """Return the number K of control points of a curve with M cubic segments: the inverse of `segments_from_points`."""
    if segments < 1:
        raise InputError(f"a curve needs at least 1 segment, not {segments}")
    return 3 * segments if mode is Mode.CLOSED else 3 * segments + 1


@dataclass(eq=False)
class Scene(CurveArrays):
    """N primitives, front to back (index 0 is the front-most), on a canvas of `width` x `height` pixels.

    mode: every primitive is of this kind.
    points: (N, K, 2) control points in px, x to the right and y down; pixel (row i, column j) has its centre at
        (j + 0.5, i + 0.5). K = 3M closed: segment m runs through points 3m, 3m+1, 3m+2, (3m+3) mod K.
        K = 3M + 1 open: segment m runs through points 3m .. 3m+3. Any finite value, on or off the canvas.
    colours: (N, 3) sRGB in [0, 1].
    opacities: (N,) in [0, 1].
    half_widths: (N,) half the stroke width in px, >= 0; all zero when closed.
    background: sRGB in [0, 1] behind everything, or None for a transparent canvas (then a render has 4 channels).
    ring_ends: (N, R) int32, or None where every curve has M segments and is one ring. Row n holds the cumulative number
        of segments at the end of each ring of curve n, its last entry repeated where it has fewer rings than R: [4, 7]
        is a ring of 4 segments and one of 3. Every ring is a closed curve of its own, through the points
        3 e_{r-1} .. 3 e_r - 1; points behind a curve's last ring are padding, which nothing reads and whose gradient is
        zero. A fill covers where the winding numbers of its rings do not add up to zero: a hole is a ring that runs
        the other way. Open curves have R = 1, the number of their segments. `pack_rings` makes both arrays.
    gradients: fills of curves that have more than their one colour, or None where all are flat; see `Gradients`.

    The arrays are float32, and all numpy's, as a fit or a file gives them, or all torch's on one device, detached
    unless the caller wants gradients; `as_torch` and `as_numpy` make the one of the other. Nothing is checked at
    construction; `validate` does.
    """

    mode: Mode
    width: int
    height: int
    points: Array
    colours: Array
    opacities: Array
    half_widths: Array
    background: tuple[float, float, float] | None = None
    ring_ends: Array | None = None
    gradients: Gradients | None = None

    @classmethod
    def filled(
        cls, width: int, height: int, rings: Sequence[Sequence[np.ndarray]], fills: np.ndarray,
        background: tuple[float, float, float] | None = None,
    ) -> Scene:  # fmt: skip
        """Return closed curves of rings (3m, 2) px and fills (N, 4), sRGB and opacity in [0, 1]; of float32 both."""
        points, ring_ends = pack_rings(Mode.CLOSED, rings)
        colours, opacities = np.ascontiguousarray(fills[:, :3]), np.ascontiguousarray(fills[:, 3])
        half_widths = np.zeros(len(fills), np.float32)
        return cls(Mode.CLOSED, width, height, points, colours, opacities, half_widths, background, ring_ends)

    @property
    def curves(self) -> int:
        """N, the number of primitives."""
        return self.points.shape[0]

    @property
    def points_per_curve(self) -> int:
        """K, the number of control points that each primitive has room for."""
        return self.points.shape[1]

    @property
    def segments(self) -> int:
        """M, the number of cubic segments of each primitive; with `ring_ends` the most that one has room for."""
        return segments_from_points(self.mode, self.points_per_curve)

    @property
    def channels(self) -> int:
        """Channels of a render: 3 (RGB) over a background, 4 (premultiplied RGBA) without one."""
        return 4 if self.background is None else 3

    @property
    def most_rings(self) -> int:
        """R, the rings that each primitive has room for."""
        return 1 if self.ring_ends is None else int(self.ring_ends.shape[-1])

    @property
    def most_stops(self) -> int:
        """S, the stops that each gradient has room for; 0 without gradients."""
        return 0 if self.gradients is None else self.gradients.most_stops

    def rings(self, curve: int) -> list[Array]:
        """Return the points of each ring of a curve, views of `points`: closed (3m, 2), open (3m + 1, 2)."""
        if self.ring_ends is None:
            return [self.points[curve]]
        (own,) = ring_slices(self.ring_ends[curve : curve + 1], closed=self.mode is Mode.CLOSED)
        return [self.points[curve, ring] for ring in own]

    def points_used(self) -> Array:
        """Return (N,) int64: the number of control points in the rings of each curve; the others are padding."""
        xp = namespace(self.points)
        if self.ring_ends is None:
            return like(self.points, [self.points_per_curve] * self.curves, "int64")
        shared = 0 if self.mode is Mode.CLOSED else 1
        return 3 * xp.astype(self.ring_ends[:, -1], xp.int64) + shared

    def unpadded(self) -> Array:
        """Return (P, 2): the control points of all rings, curve after curve."""
        if self.ring_ends is None:
            return self.points.reshape(-1, 2)
        return self.points.reshape(-1, 2)[places_used(self.points_used(), self.points_per_curve)]

    def scaled(self, width: int, height: int) -> Scene:
        """Return the scene on a canvas of width x height px; the same object if it has that size already.

        Sides are scaled independently, so that a canvas whose sides were rounded to whole pixels fits again;
        half-widths by the geometric mean of both factors.
        """
        if (self.width, self.height) == (width, height):
            return self
        across, down = width / self.width, height / self.height
        points = padded(self.unpadded() * like(self.points, [across, down]), self.points_used(), self.points_per_curve)
        gradients = None if self.gradients is None else self.gradients.scaled(across, down)
        half_widths = self.half_widths * math.sqrt(across * down)
        return replace(self, width=width, height=height, points=points, half_widths=half_widths, gradients=gradients)

    def validate(self) -> None:
        """Raise InputError, naming the variable and what it should be, unless the scene can be rendered.

        It reads values, so on a GPU it waits for them; `validate_form` does not.
        """
        self.validate_form()
        if self.ring_ends is not None:
            _check_ring_ends(self.ring_ends, self.segments)
        xp = namespace(self.points)
        bad = ~xp.isfinite(self.unpadded()).all(axis=1)
        if bad.any():
            curve = int((xp.cumsum(self.points_used(), axis=0) <= _first_curve(bad)).sum())
            raise InputError(f"points must be finite, but curve {curve} holds NaN or infinity")
        _check_range("colours", self.colours, 1.0, "between 0 and 1")
        _check_range("opacities", self.opacities, 1.0, "between 0 and 1")
        most, allowed = (0.0, "0 for closed curves") if self.mode is Mode.CLOSED else (math.inf, "at least 0")
        _check_range("half_widths", self.half_widths, most, allowed)
        if self.gradients is not None:
            self.gradients.validate()

    def validate_form(self) -> None:
        """Validate types, shapes and devices only, without a look at the arrays' values."""
        if not isinstance(self.mode, Mode):
            raise InputError(f"mode must be Mode.CLOSED or Mode.OPEN, not {self.mode!r}")
        for name, size in (("width", self.width), ("height", self.height)):
            if isinstance(size, bool) or not isinstance(size, int) or size < 1:
                raise InputError(f"{name} must be a whole number of pixels, at least 1, not {size!r}")
        self._validate_shapes()
        ground = self.background
        if ground is not None and (not isinstance(ground, tuple) or len(ground) != 3):
            raise InputError(f"background must be None or a tuple of three numbers, not {ground!r}")
        # Written so that NaN fails as well.
        if not all(isinstance(c, (int, float)) and math.isfinite(c) and 0.0 <= c <= 1.0 for c in ground or ()):
            raise InputError(f"background must hold sRGB values between 0 and 1, not {ground!r}")

    def _validate_shapes(self) -> None:
        of_one = {"colours": (3,), "opacities": (), "half_widths": ()}  # the shape of a curve's own values
        for name in ("points", *of_one):
            array = getattr(self, name)
            if not is_array(array):
                raise InputError(f"{name} must be a numpy array or a torch.Tensor, not {type(array).__name__}")
            xp = namespace(array)
            if array.dtype not in (xp.float32, xp.float64):
                raise InputError(f"{name} must be float32 or float64, not {array.dtype}")
            if kind_of(array) != kind_of(self.points):
                advice = "use one kind and device for all, by as_numpy() or as_torch() of the scene"
                raise InputError(f"{name} is {kind_of(array)} but points {kind_of(self.points)}: {advice}")
        if self.points.ndim != 3 or self.points.shape[-1] != 2 or self.curves < 1:
            raise InputError(f"points must have shape (N, K, 2) with N >= 1 curves, not {tuple(self.points.shape)}")
        segments_from_points(self.mode, self.points_per_curve)
        for name, own in of_one.items():
            shape, wanted = tuple(getattr(self, name).shape), (self.curves, *own)
            if shape != wanted:
                raise InputError(f"{name} must have shape {wanted} for {self.curves} curves, not {shape}")
        if (ends := self.ring_ends) is not None:
            like_points = is_array(ends) and kind_of(ends) == kind_of(self.points)
            if not like_points or ends.dtype != namespace(ends).int32:
                raise InputError(f"ring_ends must be {kind_of(self.points)} like points, of int32")
            most, form = (self.segments, "(N, R)") if self.mode is Mode.CLOSED else (1, "(N, 1)")
            if ends.ndim != 2 or ends.shape[0] != self.curves or not 1 <= ends.shape[1] <= most:
                raise InputError(f"ring_ends must have shape {form} for {self.curves} curves, not {tuple(ends.shape)}")
        if self.gradients is not None:
            self.gradients.validate_form(self.points)


def ring_slices(ring_ends: Array, *, closed: bool) -> list[list[slice]]:
    """Return the slices of its control points for each ring of each curve; ring_ends (N, R) as in `Scene`."""
    shared = 0 if closed else 1
    rows = [[0, *row] for row in ring_ends.tolist()]
    return [[slice(3 * a, 3 * b + shared) for a, b in itertools.pairwise(row) if a < b] for row in rows]


def pack_rings(mode: Mode, curves: Sequence[Sequence[Array]]) -> tuple[Array, Array | None]:
    """Return `points` and `ring_ends` of a scene, from the rings of each curve: (3m, 2), open (3m + 1, 2), of any type.

    points: (N, K, 2), padded with zeros and differentiable in the rings; ring_ends: (N, R) int32, or None if every
    curve is one ring of the same length. Raises InputError for no curve, a curve without rings, an open curve of
    several, or a ring without a whole number of segments.
    """
    if not curves:
        raise InputError("a scene needs at least 1 curve")
    counts = [[segments_from_points(mode, ring.shape[0]) for ring in rings] for rings in curves]
    for index, of_curve in enumerate(counts):
        if not of_curve or (mode is Mode.OPEN and len(of_curve) > 1):
            raise InputError(f"curve {index} has {len(of_curve)} rings; a closed one needs at least 1, an open one 1")
    first = curves[0][0]
    xp = namespace(first)
    whole = [xp.concat(tuple(rings)) for rings in curves]
    if len(counts[0]) == 1 and all(of_curve == counts[0] for of_curve in counts):
        return xp.stack(whole), None
    points = padded(xp.concat(tuple(whole)), like(first, [p.shape[0] for p in whole], "int64"))
    rows = [list(itertools.accumulate(of_curve)) for of_curve in counts]
    most = max(map(len, rows))
    return points, like(points, [row + row[-1:] * (most - len(row)) for row in rows], "int32")


def _check_ring_ends(ends: Array, segments: int) -> None:
    xp = namespace(ends)
    rising = xp.concat((ends[:, :1] >= 1, xp.diff(ends, axis=1) >= 0, ends[:, -1:] <= segments), axis=1)
    if not rising.all():
        curve = _first_curve(~rising)
        text = f"ring_ends must rise along each row, from 1 to at most {segments} segments"
        raise InputError(f"{text}, but curve {curve} has {ends[curve].tolist()}")


def _check_range(name: str, values: Array, high: float, wanted: str) -> None:
    """Raise InputError if a value is not finite, below 0 or above `high`; `wanted` says in words what it must be."""
    bad = ~namespace(values).isfinite(values)
    if bad.any():
        raise InputError(f"{name} must be finite, but curve {_first_curve(bad)} holds NaN or infinity")
    bad = (values < 0.0) | (values > high)
    if bad.any():
        raise InputError(f"{name} must be {wanted}, but curve {_first_curve(bad)} is outside")


def _first_curve(bad: Array) -> int:
    return int(namespace(bad).nonzero(bad)[0][0])
