"""The arguments of the CUDA kernels, which mirror kernels/cuda/frame.cuh field by field, and their buffers."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable
from ctypes import c_float, c_int, c_void_p

import torch
from torch import Tensor

from cubicsplat_cli.errors import EngineError
from cubicsplat_cli.raster.cpu import Blunting
from cubicsplat_cli.raster.engine import IMPORTANCE, EngineScene, Pass
from cubicsplat_cli.raster.native import members
from cubicsplat_cli.raster.settings import RasterSettings
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
# Bytes of a slot: kCodeBytes, and with exact coverage kExactBytes too.
SLOT_BYTES = {"relaxed": THREADS * 2, "exact": THREADS * (2 + 4)}
FIXED_SHARED = 4 * (
    LISTED + BATCH * ATTRIBUTES + MASK_WORDS + BATCH * STRIPS + BATCH + 2 * STRIPS + BATCH * (STRIPS * 8 + 8)
)
SIDE_BYTES = 4 * 13  # of an edge in spikes.h
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
        *members(c_float, "edge_width tolerance"), ("background", c_float * 4), ("rates", c_float * 9),
        ("penalty", c_float * 3), *members(c_int, "importance_kind number"),
        *members(c_void_p, "image importance background_gradient points_gradient rate_scale loss"),
        ("blunting", Blunting),
    ]  # fmt: skip


class StepFrame(ctypes.Structure):
    """`Frame`: what stays the same while a captured step lives."""

    _fields_ = [
        *members(c_int, "curves segments points_per_curve rings samples edge_stride width height tiles_x tiles_y"),
        *members(c_int, "super_shift supers_x supers_y words slots logits backward exact most_stops"),
        *members(c_void_p, "points colours opacities half_widths edge_widths ring_ends kinds counts frames offsets"),
        *members(c_void_p, "stops bounds edges inverses attributes super_masks target gradient weights"),
        *members(c_void_p, "vertex_gradients sums tile_sums order out_points out_colours out_opacities"),
        *members(c_void_p, "out_half_widths out_edge_widths out_frames out_stops moments edge_moments ages status"),
        ("step", c_void_p),
    ]


def blocks(count: int, per_block: int) -> int:
    """Return the number of blocks that hold `count` things; at least one, since an empty grid cannot be launched."""
    return max(1, -(-count // per_block))


def slots_for(coverage: str, shared_per_block: int, shared_per_sm: int) -> int:
    """Return the boundary pairs per strip whose nearest edges fit into shared memory at no cost of a resident block."""
    room = min(shared_per_sm // BLOCKS_PER_SM[coverage] - RESERVED_SHARED, shared_per_block)
    return max(0, min(MOST_SLOTS, (room - FIXED_SHARED) // SLOT_BYTES[coverage]))


def shared_bytes(coverage: str, slots: int) -> int:
    """Return the bytes of dynamic shared memory of a block of the raster kernel."""
    return FIXED_SHARED + slots * SLOT_BYTES[coverage]


def carve_out(kernel: str, shared: int, shared_per_sm: int) -> int:
    """Return the percent of a multiprocessor's shared memory that the blocks of a kernel take, as registers allow."""
    resident = BLOCKS_PER_SM.get(kernel.removeprefix("raster_"), 1)
    return min(100, blocks(100 * resident * (shared + RESERVED_SHARED), shared_per_sm))


def check_drawable(segments: int, samples: int, subdivide: bool) -> None:
    """Raise EngineError for curves of more segments, or more edges, than the kernels take, and for subdivision."""
    if subdivide:
        raise EngineError("the CUDA engine has no de Casteljau subdivision; use uniform samples, or the CPU")
    if segments > MOST_SEGMENTS or segments * samples > MOST_EDGES:
        text = f"the CUDA engine draws curves of at most {MOST_SEGMENTS} segments and {MOST_EDGES} edges"
        advice = "use fewer segments or samples, or the CPU"
        raise EngineError(f"{text}, not {segments} and {segments * samples}; {advice}")


def sizes_of(scene: EngineScene, settings: RasterSettings) -> dict[str, int]:
    """Return the fields that sizes of buffers depend on. Raises EngineError if this engine cannot draw the scene."""
    n, k = int(scene.curves), int(scene.points_per_curve)
    segments, rest = divmod(k, 3)
    if segments < 1 or rest != (scene.mode is Mode.OPEN) or scene.width < 1 or scene.height < 1:
        raise EngineError(f"a {scene.mode.value} curve cannot have {k} control points, or the canvas is empty")
    check_drawable(segments, settings.samples, settings.subdivide)
    tiles = -(-scene.width // TILE), -(-scene.height // TILE)
    shift = SUPER_SHIFT  # tiles per side of a super-tile, as a power of two
    while math.prod(supers := [-(-side >> shift) for side in tiles]) > MOST_SUPERS:
        shift += 1
    return {
        "curves": n, "segments": segments, "points_per_curve": k, "samples": settings.samples,
        "edge_stride": segments * settings.samples, "width": scene.width, "height": scene.height,
        "tiles_x": tiles[0], "tiles_y": tiles[1], "super_shift": shift, "supers_x": supers[0], "supers_y": supers[1],
        "words": blocks(n, WARP),
    }  # fmt: skip


def workspace(
    frame: StepFrame, most_looks: int, allocate: Callable[[str, int, torch.dtype], Tensor]
) -> dict[str, Tensor]:
    """Return the buffers between the kernels, by the names of their fields in `Frame`.

    most_looks: of tiles at curves; if there would be more, curves are sorted into super-tiles first.
    allocate(what, count, dtype) gives an uninitialised tensor, or raises EngineError.
    """
    n, stride, tiles = max(frame.curves, 1), frame.edge_stride, frame.tiles_x * frame.tiles_y
    floats = {
        "bounds": ("the curves' bounds", 4 * n), "edges": ("the curves' edges", 4 * n * stride),
        "inverses": ("the curves' edges", 2 * n * stride), "attributes": ("the curves' values", ATTRIBUTES * n),
    }  # fmt: skip
    if frame.backward:
        floats |= {
            "vertex_gradients": ("the vertices' gradients", 2 * n * (stride + 1)),
            "sums": ("the curves' gradients", SUMS * n), "tile_sums": ("the tiles' sums", 8 * tiles),
        }  # fmt: skip
    buffers = {name: allocate(what, count, torch.float32) for name, (what, count) in floats.items()}
    if frame.curves * tiles > most_looks:
        buffers["super_masks"] = allocate("the super-tiles", frame.supers_x * frame.supers_y * frame.words, torch.int32)
    return buffers


def order_places(frame: StepFrame) -> int:
    """Return the length of the two lists of tiles by time, which begin with zeros (order.cuh); 0 for none."""
    tiles = frame.tiles_x * frame.tiles_y
    return 2 * COSTS * (1 + tiles) if tiles <= MOST_ORDERED else 0


def put(structure: StepFrame | StepValues, addresses: dict[str, int | None]) -> None:
    """Put addresses into the fields of their names."""
    for name, address in addresses.items():
        setattr(structure, name, address)


def step_values(scene: EngineScene, settings: RasterSettings, device: torch.device, given: Pass) -> StepValues:
    """Return the values of a pass, but the loss and what only training has. Raises EngineError for unfit tensors."""
    filled = {"image": given.image} | {name: given.out.get(name) for name in ("importance", "background")}
    addresses = scene.addresses(device, filled)
    return StepValues(
        edge_width=settings.edge_width, tolerance=settings.tolerance,
        background=(c_float * 4)(*(scene.background or ()), 0.0), importance_kind=IMPORTANCE[given.importance],
        penalty=(c_float * 3)(*given.penalty), image=addresses["image"],
        importance=addresses["importance"], background_gradient=addresses["background"],
    )  # fmt: skip
