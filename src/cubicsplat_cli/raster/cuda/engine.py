"""The CUDA engine: the same methods as the CPU engine, on tensors that live on the GPU.

A step is four kernels (flatten, bin, raster, update), or five with the penalty on spikes (blunt first), with nothing in
between. So it is captured in a CUDA graph and replayed; a tiny kernel before each replay brings the values that change
from step to step. Nothing waits for the GPU but what hands a number to Python: `gradients()` for its loss, and whoever
reads the loss of a step. See docs/cuda.md.
"""

from __future__ import annotations

import ctypes
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cubicsplat_cli.errors import DeviceError
from cubicsplat_cli.raster.cuda.compile import Program
from cubicsplat_cli.raster.cuda.driver import Driver, Kernels, cuda_driver
from cubicsplat_cli.raster.cuda.frame import (
    MOST_LOOKS,
    SIDE_BYTES,
    SMALL_THREADS,
    THREADS,
    WARP,
    StepFrame,
    StepValues,
    blocks,
    order_places,
    put,
    shared_bytes,
    sizes_of,
    slots_for,
    step_values,
    workspace,
)
from cubicsplat_cli.raster.cuda.selftest import self_test
from cubicsplat_cli.raster.engine import RATED, Checkpoint, Engine, EngineScene, Pass, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene.arrays import Array, as_torch
from cubicsplat_cli.settings import Mode

PLANS_KEPT = 2  # prepared steps: those of the relaxed phase and of the exact finish


@dataclass(eq=False)
class _Plan:
    """A prepared step, captured when it came a second time. blunted: `Blunting.edges`, 0 without that penalty."""

    frame: StepFrame
    blunted: int
    kernels: Kernels
    step: Tensor  # the device's StepValues
    kept: tuple[object, ...]  # whatever else the frame points to
    ran: bool = False
    replay: Callable[[], None] | None = None


class CudaEngine(Engine):
    """The CUDA engine on one GPU. Steps are not to be made from several Python threads at once.

    device: torch's number of the GPU (default: its current one). program: what it will draw first, loaded now. driver:
    another device, for tests. Raises EngineError with the reason if it cannot run. Every program is tried on a tiny
    scene before its first use in the process (`self_test`).
    """

    name = "cuda"
    runs_ahead = True
    at_once = 16
    most_looks = MOST_LOOKS

    def __init__(
        self, device: int | None = None, program: Program | None = None, *, driver: Driver | None = None
    ) -> None:
        self._driver: Driver = driver or cuda_driver(device)
        self.device = self._driver.device
        self._plans: OrderedDict[bytes, _Plan] = OrderedDict()
        self._number = 0
        self._has_turn = False
        with self._driver.active():
            self._status = self._allocate("the status", 2, torch.int32).zero_()
            self._late_status = self._driver.late_copy(self._status)
        self._load(program or Program(Mode.CLOSED, 3))

    def take(self, array: Array) -> Tensor:
        return as_torch(array, self.device)

    def close(self) -> None:
        """Free the prepared steps and their memory, and forget a fault; the next step prepares its own again."""
        with self._driver.lock:
            self._plans.clear()
        with self._driver.active():
            self._status.zero_()
        self._number = 0

    def guarded(self) -> AbstractContextManager[Any]:
        return self._driver.active()

    @contextmanager
    def turn(self) -> Iterator[None]:
        with self._driver.turns:
            self._has_turn = True
            try:
                yield
            finally:
                self._has_turn = False

    def wait(self) -> None:
        if not self._has_turn:
            return
        self._driver.turns.release()
        try:
            self._driver.wait()
        finally:
            self._driver.turns.acquire()

    def describe(self) -> dict[str, object]:
        return {"name": self.name, **self._driver.describe()}

    def render(self, scene: EngineScene, settings: RasterSettings) -> Tensor:
        with self._driver.active():
            image = self._picture(scene)
            self._run(scene, settings, Pass(None, image=image))
        return image

    def _gradients(self, scene: EngineScene, settings: RasterSettings, given: Pass) -> float:
        with self._driver.active():
            if given.importance == "loo":
                given.image = self._picture(scene)
            loss = torch.zeros((), dtype=torch.float64, device=self.device)
            self._run(scene, settings, given, loss)
            return float(loss) if given.target is not None else 0.0  # reading it waits for the GPU

    def steps(
        self, scene: EngineScene, settings: RasterSettings, training: Training, paces: np.ndarray, seconds: float,
        best: Checkpoint | None = None,
    ) -> Tensor:  # fmt: skip
        """See `Engine.steps`. It does not wait: all steps are queued whatever their time, the losses come as a float64
        tensor (n,) on the GPU, float() of which waits, and a `best` cannot be kept.

        A step on the same tensors as before is replayed from a CUDA graph, so change tensors in place where you can.
        """
        assert best is None
        frame = self._frame(scene, settings, training, backward=True)
        put(frame, scene.addresses(self.device, vars(training.state)))
        values = self._training_values(scene, settings, training)
        kept = (scene, *training.pictures.values(), *training.out.values(), training.state)
        with self._driver.active():
            penalty, blunted = training.blunting, 0
            if penalty is not None:
                values.blunting, blunted = penalty, penalty.edges
            blunting = values.blunting
            plan = self._plan(frame, scene, blunted, kept)
            if training.importance == "loo" and training.image is None:
                image = self._picture(scene)
                values.image = image.data_ptr()
            losses = torch.empty(len(paces), dtype=torch.float64, device=self.device)
            for index, (edge_width, *rates) in enumerate(paces.tolist()):
                values.edge_width, values.rates[:RATED], values.number = edge_width, rates, self._number
                if penalty is not None:
                    blunting.left = penalty.left
                    penalty.left = (penalty.left or penalty.every) - 1
                    if index > 0:
                        blunting.loss_at = values.loss  # of the step before
                values.loss = losses.data_ptr() + index * losses.itemsize
                self._set_step(plan.kernels, values, plan.step)
                self._repeat(plan)
                self._number += 1
        return losses

    def fault(self, wait: bool = True) -> tuple[int, int] | None:
        """See `Engine.fault`; steps are counted from 0 since `close`."""
        with self._driver.active():
            found = self._status.tolist() if wait else self._late_status.poll()
        return (found[0] - 1, found[1]) if found and found[0] else None

    # How a call is prepared

    def _allocate(self, what: str, count: int, dtype: torch.dtype) -> Tensor:
        try:
            return torch.empty(count, dtype=dtype, device=self.device)
        except RuntimeError as error:  # torch.OutOfMemoryError is one; its CPU allocator raises a plain one
            if "memory" not in str(error):
                raise
            size = count * dtype.itemsize / 1e6
            text = f"the GPU has no room for {what} ({size:.0f} MB more)"
            raise DeviceError(f"{text}; lower --curves, --samples or --max-size, or use --device cpu") from error

    def _load(self, program: Program) -> Kernels:
        driver = self._driver
        with driver.lock:
            kernels = driver.kernels(program)
            if program not in driver.tested:
                driver.tested.add(program)  # the test's own calls come through here
                try:
                    tester = CudaEngine(program=program, driver=driver)
                    tester.most_looks = 0  # so that all kernels run
                    self_test(tester, program)
                except BaseException:
                    driver.tested.discard(program)
                    raise
            return kernels

    def _set_step(self, kernels: Kernels, values: StepValues, step: Tensor) -> None:
        kernels.launch("set_step", (1, 1), WARP, 0, values, ctypes.c_void_p(step.data_ptr()))

    def _launch(self, kernels: Kernels, frame: StepFrame, blunted: int = 0) -> None:
        """Queue the kernels of one step, render or gradient. blunted: as of `_Plan`."""
        if blunted:
            shared = frame.segments * blunted * SIDE_BYTES
            kernels.launch("blunt", (max(1, frame.curves), 1), SMALL_THREADS, shared, frame)
        per_block = SMALL_THREADS // WARP
        coverage = "exact" if frame.exact else "relaxed"
        curves = blocks(frame.curves, per_block)
        supers = blocks(frame.supers_x * frame.supers_y, WARP)
        kernels.launch("flatten", (curves, 1), SMALL_THREADS, 0, frame)
        if frame.super_masks:
            kernels.launch("bin", (blocks(frame.words, per_block), supers), SMALL_THREADS, 0, frame)
        shared = shared_bytes(coverage, frame.slots)
        kernels.launch(f"raster_{coverage}", (frame.tiles_x * frame.tiles_y, 1), THREADS, shared, frame)
        if frame.backward:
            kernels.launch("update", (1 + curves, 1), SMALL_THREADS, 0, frame)

    def _frame(self, scene: EngineScene, settings: RasterSettings, given: Pass, *, backward: bool) -> StepFrame:
        """Return the frame of a pass, without buffers and optimiser. Raises EngineError for unfit tensors or scenes."""
        slots = slots_for(settings.coverage, self._driver.shared_per_block, self._driver.shared_per_sm)
        frame = StepFrame(
            **sizes_of(scene, settings), rings=scene.most_rings, slots=slots, logits=scene.logits, backward=backward,
            exact=settings.coverage == "exact", most_stops=scene.most_stops, **scene.own_addresses(self.device),
            **scene.addresses(self.device, given.pictures),
        )  # fmt: skip
        out = {name: tensor for name, tensor in given.out.items() if name not in ("background", "importance")}
        found = scene.addresses(self.device, out, "gradient of ")
        put(frame, {f"out_{name}": address for name, address in found.items()})
        return frame

    def _attach_workspace(self, frame: StepFrame) -> tuple[Tensor, dict[str, Tensor]]:
        """Give a frame its buffers, and return them: the device's StepValues, and those between the kernels."""
        step = self._allocate("the settings", ctypes.sizeof(StepValues), torch.uint8)
        buffers = workspace(frame, self.most_looks, self._allocate)
        named = buffers | {"step": step, "status": self._status}
        put(frame, {name: tensor.data_ptr() for name, tensor in named.items()})
        return step, buffers

    def _run(self, scene: EngineScene, settings: RasterSettings, given: Pass, loss: Tensor | None = None) -> None:
        """Run a pass without a graph, in buffers of its own, so that passes on several streams do not meet."""
        frame = self._frame(scene, settings, given, backward=bool(given.out))
        values = step_values(scene, settings, self.device, given)
        values.loss = None if loss is None else loss.data_ptr()
        kernels = self._load(Program.of(scene))
        step, buffers = self._attach_workspace(frame)
        self._set_step(kernels, values, step)
        self._launch(kernels, frame)
        del buffers  # until here the frame points to them

    def _picture(self, scene: EngineScene) -> Tensor:
        """Return a buffer (H, W, C) for a picture, which leave-one-out importance is computed from."""
        size = scene.height, scene.width, scene.channels
        return self._allocate("the picture", math.prod(size), torch.float32).view(size)

    def _training_values(self, scene: EngineScene, settings: RasterSettings, training: Training) -> StepValues:
        values = step_values(scene, settings, self.device, training)
        rates = training.rates
        values.rates = (ctypes.c_float * 9)(*rates.sizes, *rates.keep, rates.epsilon)  # as `AdanRates` in curve.h
        names = ("points_gradient", "rate_scale")
        put(values, scene.addresses(self.device, {name: getattr(training, name) for name in names}))
        return values

    def _plan(self, frame: StepFrame, scene: EngineScene, blunted: int, kept: tuple[object, ...]) -> _Plan:
        """Return the prepared step for these tensors and settings. A frame holds nothing that differs between steps.

        A stream has plans of its own: their buffers are of its memory, which is given out again in its order.
        """
        key = bytes(frame) + f"{Program.of(scene).name} {self._driver.stream()} {blunted}".encode()
        if key in self._plans:
            self._plans.move_to_end(key)
            return self._plans[key]
        kernels = self._load(Program.of(scene))
        with self._driver.lock:
            while len(self._plans) >= PLANS_KEPT:
                self._plans.popitem(last=False)
        step, buffers = self._attach_workspace(frame)
        order = None
        if places := order_places(frame):
            order = self._allocate("the tiles' order", places, torch.int32).zero_()
            frame.order = order.data_ptr()
        plan = self._plans[key] = _Plan(frame, blunted, kernels, step, (buffers, order, *kept))
        return plan

    def _repeat(self, plan: _Plan) -> None:
        """Run a plan: directly at first, which also loads the kernels, and from a graph ever after."""
        if not plan.ran:
            self._launch(plan.kernels, plan.frame, plan.blunted)
            plan.ran = True
            return
        if plan.replay is None:
            with self._driver.lock:
                plan.replay = self._driver.capture(lambda: self._launch(plan.kernels, plan.frame, plan.blunted))
        plan.replay()
