"""What the CUDA kernels are told: mirrors of kernels/cuda/frame.cuh, field by field, and the buffers they work in."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from ctypes import c_float, c_int, c_void_p
from dataclasses import dataclass
from functools import lru_cache

import torch
from torch import Tensor

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.engine import IMPORTANCE, EngineScene, Pointer, Rates
from cubicsplat_cli.raster.settings import SQUARED, Penalty, RasterSettings
from cubicsplat_cli.settings import Mode

# Twins of the constants in frame.cuh.
WARP = 32
TILE = 16
THREADS = 256
SMALL_THREADS = 128
STRIPS = 8
LISTED = 512
BATCH = 32
MASK_WORDS = 1024
MOST_SLOTS = 16
ATTRIBUTES = 12
SUMS = 8
COSTS = 16
MOST_ORDERED = 6000  # tiles; with more, all multiprocessors are busy to the end in any order
CODE_BYTES = THREADS * 2
EXACT_BYTES = THREADS * 4
FIXED_SHARED = 4 * (
    LISTED + BATCH * ATTRIBUTES + MASK_WORDS + BATCH * STRIPS + BATCH + 2 * STRIPS + BATCH * (STRIPS * 8 + 8)
)
RESERVED_SHARED = 1024  # bytes of each block that the system keeps for itself
BLOCKS_PER_SM = {"relaxed": 4, "exact": 3}  # what the kernels' registers allow (launch bounds)

MOST_EDGES = MASK_WORDS // STRIPS * WARP  # of one curve: a set of them must fit into a batch
MOST_SEGMENTS = 42  # a row crosses a cubic three times at most, and windings are kept in signed bytes
MOST_SUPERS = 1024
SUPER_SHIFT = 3
MOST_LOOKS = 1 << 20  # of tiles at curves, 16 bytes each: less than what sorting the curves into super-tiles costs


class StepValues(ctypes.Structure):
    """`Step`: what may change between two replays of a captured step."""

    _fields_ = [
        ("edge_width", c_float), ("tolerance", c_float), ("background", c_float * 4),
        ("rates", c_float * 9), ("penalty", c_float * 3), ("importance_kind", c_int), ("number", c_int),
        ("image", c_void_p), ("importance", c_void_p), ("background_gradient", c_void_p), ("points_gradient", c_void_p),
        ("rate_scale", c_void_p),
        ("loss", c_void_p),
    ]  # fmt: skip


class Frame(ctypes.Structure):
    """`Frame`: what stays the same while a captured step lives."""

    _fields_ = [
        (name, c_int)
        for name in (
            "curves", "segments", "points_per_curve", "rings", "samples", "edge_stride", "width", "height",
            "tiles_x", "tiles_y", "super_shift", "supers_x", "supers_y", "words", "slots", "logits", "backward",
            "exact", "most_stops",
        )
    ] + [
        (name, c_void_p)
        for name in (
            "points", "colours", "opacities", "half_widths", "edge_widths", "ring_ends",
            "kinds", "counts", "frames", "offsets", "stops", "bounds", "edges", "inverses", "attributes", "super_masks",
            "target", "gradient", "weights", "vertex_gradients", "sums", "tile_sums", "order",
            "out_points", "out_colours", "out_opacities", "out_half_widths", "out_edge_widths",
            "out_frames", "out_stops",
            "moments", "edge_moments", "ages", "status", "step",
        )
    ]  # fmt: skip


def pointer_on(device: torch.device) -> Pointer:
    """Gives addresses of tensors that kernels on this device can use, and raises EngineError of any others."""

    def pointer(tensor: Tensor | None, name: str, shape: tuple[int, ...], dtype: str) -> int | None:
        if tensor is None:
            return None
        fits = tuple(tensor.shape) == shape and tensor.dtype == getattr(torch, dtype)
        if not fits or tensor.device != device or not tensor.is_contiguous():
            raise EngineError(
                f"{name} must be a contiguous torch.{dtype} tensor of shape {shape} on {device}, "
                f"not {tensor.dtype} {tuple(tensor.shape)} on {tensor.device}"
            )
        return tensor.data_ptr()

    return pointer


def blocks(count: int, per_block: int) -> int:
    """Blocks that hold `count` things; at least one, since an empty grid cannot be launched."""
    return max(1, -(-count // per_block))


def slots_for(coverage: str, shared_per_block: int, shared_per_sm: int) -> int:
    """Boundary pairs per strip whose nearest edges fit into shared memory without costing a resident block."""
    exact = coverage == "exact"
    room = min(shared_per_sm // BLOCKS_PER_SM[coverage] - RESERVED_SHARED, shared_per_block)
    return max(0, min(MOST_SLOTS, (room - FIXED_SHARED) // (CODE_BYTES + (EXACT_BYTES if exact else 0))))


def shared_bytes(coverage: str, slots: int) -> int:
    """Dynamic shared memory of a block of the raster kernel."""
    return FIXED_SHARED + slots * (CODE_BYTES + (EXACT_BYTES if coverage == "exact" else 0))


def carve_out(kernel: str, shared: int, shared_per_sm: int) -> int:
    """Percent of a multiprocessor's shared memory that a raster kernel's blocks take, as many as registers allow."""
    resident = BLOCKS_PER_SM[kernel.removeprefix("raster_")]
    return min(100, blocks(100 * resident * (shared + RESERVED_SHARED), shared_per_sm))


def _supers(tiles: tuple[int, int], shift: int) -> tuple[int, int]:
    return -(-tiles[0] >> shift), -(-tiles[1] >> shift)


@lru_cache(maxsize=64)
def _super_shift(tiles: tuple[int, int]) -> int:
    shift = SUPER_SHIFT
    while math.prod(_supers(tiles, shift)) > MOST_SUPERS:
        shift += 1
    return shift


def check_lengths(segments: int, samples: int) -> None:
    """Raises EngineError where curves of so many segments and edges per cubic are too long for the kernels."""
    if segments > MOST_SEGMENTS or segments * samples > MOST_EDGES:
        raise EngineError(
            f"the CUDA engine draws curves of at most {MOST_SEGMENTS} segments and {MOST_EDGES} edges, not "
            f"{segments} and {segments * samples}; use fewer segments or samples, or the CPU"
        )


@dataclass(frozen=True)
class Sizes:
    """What the buffers' sizes depend on."""

    curves: int
    segments: int
    points_per_curve: int
    width: int
    height: int
    samples: int
    backward: bool
    most_looks: int

    @classmethod
    def of(cls, scene: EngineScene, settings: RasterSettings, backward: bool, most_looks: int = MOST_LOOKS) -> Sizes:
        """Sizes of a scene; raises EngineError where this engine cannot draw it.

        most_looks: of tiles at curves; where there would be more, curves are sorted into super-tiles first.
        """
        if settings.subdivide:
            raise EngineError("the CUDA engine has no de Casteljau subdivision; use uniform samples, or the CPU")
        n, k = int(scene.points.shape[0]), int(scene.points.shape[1])
        closed = scene.mode is Mode.CLOSED
        segments = k // 3
        if segments < 1 or k != 3 * segments + (0 if closed else 1) or scene.width < 1 or scene.height < 1:
            raise EngineError(f"a {scene.mode.value} curve cannot have {k} control points, or the canvas is empty")
        check_lengths(segments, settings.samples)
        return cls(n, segments, k, scene.width, scene.height, settings.samples, backward, most_looks)

    @property
    def edge_stride(self) -> int:
        return self.segments * self.samples

    @property
    def tiles(self) -> tuple[int, int]:
        return -(-self.width // TILE), -(-self.height // TILE)

    @property
    def super_shift(self) -> int:
        """Tiles per side of a super-tile, as a power of two."""
        return _super_shift(self.tiles)

    @property
    def supers(self) -> tuple[int, int]:
        """Columns and rows of super-tiles."""
        return _supers(self.tiles, self.super_shift)

    @property
    def words(self) -> int:
        return blocks(self.curves, WARP)

    @property
    def binned(self) -> bool:
        """Whether curves are sorted into super-tiles before the tiles look at them."""
        return self.curves * math.prod(self.tiles) > self.most_looks


Allocate = Callable[[str, int, torch.dtype], Tensor]


class Workspace:
    """The buffers between the kernels, for scenes of one size."""

    def __init__(self, sizes: Sizes, allocate: Allocate) -> None:
        """allocate(what, count, dtype) gives an uninitialised tensor, or raises EngineError."""
        self.sizes = sizes
        n, stride, tiles = max(sizes.curves, 1), sizes.edge_stride, sizes.tiles[0] * sizes.tiles[1]

        def floats(what: str, count: int) -> Tensor:
            return allocate(what, count, torch.float32)

        self.bounds = floats("the curves' bounds", 4 * n)
        self.edges = floats("the curves' edges", 4 * n * stride)
        self.inverses = floats("the curves' edges", 2 * n * stride)
        self.attributes = floats("the curves' values", ATTRIBUTES * n)
        self.super_masks = None
        if sizes.binned:
            self.super_masks = allocate("the super-tiles", math.prod(sizes.supers) * sizes.words, torch.int32)
        self.vertex_gradients = self.sums = self.tile_sums = None
        if sizes.backward:
            self.vertex_gradients = floats("the vertices' gradients", 2 * n * (stride + 1))
            self.sums = floats("the curves' gradients", SUMS * n)
            self.tile_sums = floats("the tiles' sums", 8 * tiles)

    def tensors(self) -> dict[str, Tensor]:
        """Every buffer by the name of its field in `Frame`."""
        return {name: t for name, t in vars(self).items() if isinstance(t, Tensor)}


def order_places(frame: Frame) -> int:
    """Numbers in the two lists of tiles by their time, which are zero before the first step (order.cuh); 0 for none."""
    tiles = frame.tiles_x * frame.tiles_y
    return 2 * COSTS * (1 + tiles) if tiles <= MOST_ORDERED else 0


def make_frame(scene: EngineScene, settings: RasterSettings, sizes: Sizes, slots: int, device: torch.device) -> Frame:
    """The frame of a scene, without buffers, pictures, outputs and optimiser. Raises EngineError for unfit tensors."""
    n, k = sizes.curves, sizes.points_per_curve
    rings = 1 if scene.ring_ends is None else int(scene.ring_ends.shape[-1])
    return Frame(
        curves=n, segments=sizes.segments, points_per_curve=k, rings=rings, samples=sizes.samples,
        edge_stride=sizes.edge_stride, width=sizes.width, height=sizes.height,
        tiles_x=sizes.tiles[0], tiles_y=sizes.tiles[1], super_shift=sizes.super_shift, supers_x=sizes.supers[0],
        supers_y=sizes.supers[1], words=sizes.words, slots=slots, logits=scene.logits, backward=sizes.backward,
        exact=settings.coverage == "exact",
        most_stops=0 if scene.gradients is None else scene.gradients.most_stops,
        **scene.own_addresses(pointer_on(device)),
    )  # fmt: skip


def put(structure: Frame | StepValues, addresses: dict[str, int | None]) -> None:
    """Puts addresses into the fields of their names."""
    for name, address in addresses.items():
        setattr(structure, name, address)


def attach(frame: Frame, tensors: dict[str, Tensor]) -> None:
    """Puts the addresses of tensors into the fields of their names."""
    put(frame, {name: tensor.data_ptr() for name, tensor in tensors.items()})


def step_values(
    scene: EngineScene,
    settings: RasterSettings,
    importance: str | None,
    number: int = 0,
    penalty: Penalty = SQUARED,
) -> StepValues:
    """The values of one call, without rates and outputs."""
    return StepValues(
        edge_width=settings.edge_width, tolerance=settings.tolerance,
        background=(c_float * 4)(*(scene.background or ()), 0.0), importance_kind=IMPORTANCE[importance], number=number,
        penalty=(c_float * 3)(*penalty),
    )  # fmt: skip


def set_rates(values: StepValues, rates: Rates) -> None:
    """Puts the rates in the order of `AdanRates` in curve.h."""
    values.rates = (c_float * 9)(
        rates.points, rates.colours, rates.opacities, rates.half_widths, rates.edge_widths, *rates.keep, rates.epsilon
    )
