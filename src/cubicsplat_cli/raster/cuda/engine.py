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
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from cubicsplat_cli.errors import DeviceError
from cubicsplat_cli.raster.cpu import pointer_on
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
    attach,
    blocks,
    make_frame,
    order_places,
    put,
    set_rates,
    shared_bytes,
    slots_for,
    step_values,
    workspace,
)
from cubicsplat_cli.raster.cuda.selftest import self_test
from cubicsplat_cli.raster.engine import RATED, Backward, Checkpoint, Engine, EngineScene, Training
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene.arrays import Array, as_torch
from cubicsplat_cli.settings import Mode

PLANS_KEPT = 2  # prepared steps: those of the relaxed phase and of the exact finish


@dataclass(eq=False)
class _Plan:
    """A step that has been prepared, and captured when it came a second time. blunted: edges of a cubic's polyline for
    the penalty on spikes and slivers, 0 without one.
    """

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
    another device, for tests. Raises EngineError with the reason where it cannot run. Every program is tried on a tiny
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
        self._pointer = pointer_on(self.device)
        self._plans: OrderedDict[bytes, _Plan] = OrderedDict()
        self._number = 0
        with self._driver.active():
            self._status = self._allocate("the status", 2, torch.int32).zero_()
            self._late_status = self._driver.late_copy(self._status)
        self._load(program or Program(Mode.CLOSED, 3))

    def take(self, array: Array) -> Tensor:
        return as_torch(array, self.device)

    def close(self) -> None:
        """Frees the prepared steps and their memory, and forgets a fault; the next step prepares its own again."""
        with self._driver.lock:
            self._plans.clear()
        with self._driver.active():
            self._status.zero_()
        self._number = 0

    def guarded(self) -> AbstractContextManager[Any]:
        return self._driver.active()

    def describe(self) -> dict[str, object]:
        return {"name": self.name, **self._driver.describe()}

    def render(self, scene: EngineScene, settings: RasterSettings) -> Tensor:
        with self._driver.active():
            image = self._allocate("the picture", scene.height * scene.width * scene.channels, torch.float32)
            values = step_values(scene, settings, None)
            values.image = image.data_ptr()
            self._run(scene, settings, values, {}, {})
        return image.view(scene.height, scene.width, scene.channels)

    def _gradients(self, scene: EngineScene, settings: RasterSettings, wanted: Backward) -> float:
        target, importance, out = wanted.target, wanted.importance, wanted.out
        values = step_values(scene, settings, importance, penalty=wanted.penalty)
        values.background_gradient = out["background"].data_ptr()
        if importance:
            values.importance = out["importance"].data_ptr()
        parameters = {f"out_{name}": t for name, t in out.items() if name not in ("background", "importance")}
        pictures = {"target": target, "gradient": wanted.gradient, "weights": wanted.weights}
        with self._driver.active():
            image = self._picture_for(scene, importance)
            values.image = None if image is None else image.data_ptr()
            loss = torch.zeros((), dtype=torch.float64, device=self.device)
            values.loss = loss.data_ptr()
            self._run(scene, settings, values, pictures, parameters)
            return float(loss) if target is not None else 0.0  # reading it waits for the GPU

    def step(self, scene: EngineScene, settings: RasterSettings, training: Training) -> Tensor:
        """It does not wait: the loss comes as a float64 tensor without dimensions on the GPU, and float() of it waits.

        A step on the same tensors as before is replayed from a CUDA graph, so change tensors in place where you can.
        """
        pace = settings.edge_width, *training.rates.sizes
        return self.steps(scene, settings, training, np.array([pace], np.float32))[0]

    def steps(
        self, scene: EngineScene, settings: RasterSettings, training: Training, paces: np.ndarray,
        seconds: float = math.inf, best: Checkpoint | None = None,
    ) -> Tensor:  # fmt: skip
        """See `Engine.steps`. It does not wait: all steps are queued whatever their time, the losses come as a float64
        tensor (n,) on the GPU, and a `best` cannot be kept.
        """
        assert best is None
        frame = self._training_frame(scene, settings, training)
        values = self._training_values(scene, settings, training)
        pictures = (training.target, training.weights, training.image_gradient)
        found = (training.of_points, training.frames_gradient, training.stops_gradient)
        with self._driver.active():
            blunted = 0 if training.blunting is None else training.blunting.edges
            plan = self._plan(frame, scene, blunted, (scene, *pictures, *found, training.state))
            if training.image is None and (image := self._picture_for(scene, training.wanted_importance)) is not None:
                values.image = image.data_ptr()
            losses = torch.empty(len(paces), dtype=torch.float64, device=self.device)
            for index, (edge_width, *rates) in enumerate(paces.tolist()):
                values.edge_width, values.rates[:RATED], values.number = edge_width, rates, self._number
                if (penalty := training.blunting) is not None:
                    values.blunting = penalty
                    penalty.left = (penalty.left or penalty.every) - 1
                    if index > 0:
                        values.blunting.loss_at = values.loss  # of the step before
                values.loss = losses.data_ptr() + index * losses.itemsize
                self._set_step(plan.kernels, values, plan.step)
                self._repeat(plan)
                self._number += 1
        return losses

    def fault(self, wait: bool = True) -> tuple[int, int] | None:
        """See `Engine.fault`; the steps are counted from 0 since `close`."""
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
            raise DeviceError(
                f"the GPU has no room for {what} ({size:.0f} MB more); lower --curves, --samples or --max-size, or "
                "use --device cpu"
            ) from error

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
        """Queues the kernels of one step, render or gradient. blunted: as of `_Plan`."""
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

    def _frame(self, scene: EngineScene, settings: RasterSettings, *, backward: bool) -> StepFrame:
        slots = slots_for(settings.coverage, self._driver.shared_per_block, self._driver.shared_per_sm)
        return make_frame(scene, settings, slots, self.device, backward=backward)

    def _attach_workspace(self, frame: StepFrame) -> tuple[Tensor, dict[str, Tensor]]:
        """Gives a frame its buffers: the device's StepValues, and those between the kernels."""
        step = self._allocate("the settings", ctypes.sizeof(StepValues), torch.uint8)
        buffers = workspace(frame, self.most_looks, self._allocate)
        attach(frame, buffers | {"step": step, "status": self._status})
        return step, buffers

    def _run(
        self,
        scene: EngineScene,
        settings: RasterSettings,
        values: StepValues,
        pictures: dict[str, Tensor | None],
        outputs: dict[str, Tensor],
    ) -> None:
        """One call without a graph, in buffers of its own, so that calls on several streams do not meet."""
        frame = self._frame(scene, settings, backward=bool(outputs))
        put(frame, scene.addresses(self._pointer, pictures))
        kernels = self._load(Program.of(scene))
        step, buffers = self._attach_workspace(frame)
        attach(frame, outputs)
        self._set_step(kernels, values, step)
        self._launch(kernels, frame)
        del buffers  # until here the frame points to them

    def _picture_for(self, scene: EngineScene, importance: str | None) -> Tensor | None:
        """The buffer of the picture that leave-one-out importance is computed from."""
        if importance != "loo":
            return None
        return self._allocate("the picture", scene.height * scene.width * scene.channels, torch.float32)

    def _training_frame(self, scene: EngineScene, settings: RasterSettings, training: Training) -> StepFrame:
        frame = self._frame(scene, settings, backward=True)
        pictures = {"target": training.target, "weights": training.weights}
        put(frame, scene.addresses(self._pointer, pictures | vars(training.state)))
        renamed = {
            "gradient": "image_gradient", "out_points": "of_points", "out_frames": "frames_gradient",
            "out_stops": "stops_gradient",
        }  # fmt: skip
        found = scene.addresses(self._pointer, {name: getattr(training, name) for name in renamed.values()})
        put(frame, {field: found[name] for field, name in renamed.items()})
        return frame

    def _training_values(self, scene: EngineScene, settings: RasterSettings, training: Training) -> StepValues:
        values = step_values(scene, settings, training.wanted_importance, penalty=training.penalty)
        set_rates(values, training.rates)
        names = ("image", "importance", "points_gradient", "rate_scale")
        put(values, scene.addresses(self._pointer, {name: getattr(training, name) for name in names}))
        return values

    def _plan(self, frame: StepFrame, scene: EngineScene, blunted: int, kept: tuple[object, ...]) -> _Plan:
        """The prepared step for these tensors and settings; what differs from step to step is not part of a frame.

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
            attach(frame, {"order": order})
        plan = self._plans[key] = _Plan(frame, blunted, kernels, step, (buffers, order, *kept))
        return plan

    def _repeat(self, plan: _Plan) -> None:
        """Runs a plan: directly at first, which also loads the kernels, and from a graph ever after."""
        if not plan.ran:
            self._launch(plan.kernels, plan.frame, plan.blunted)
            plan.ran = True
            return
        if plan.replay is None:
            with self._driver.lock:
                plan.replay = self._driver.capture(lambda: self._launch(plan.kernels, plan.frame, plan.blunted))
        plan.replay()
