"""The fit of moving pictures: knots, the joint fit's gradient, and whole clips."""

from __future__ import annotations

import gzip
import itertools
import math
import time
from dataclasses import replace

import numpy as np
import pytest
from conftest import ctrl_c_when
from moving_scenes import scene_at

from cubicsplat_cli.motion.fitting import ClipFit, FrameGroup, fit_clip, groups
from cubicsplat_cli.motion.following import Follower, flow, sampled
from cubicsplat_cli.motion.knots import START_BYTES, Choice, choose, curve_bytes, knot_bytes, sensitivity
from cubicsplat_cli.motion.tracks import KEEP_MEAN, KEEP_SQUARE, JointFit, KnotTrack, Tracks
from cubicsplat_cli.photo.loop import FitLoop
from cubicsplat_cli.photo.stepper import FINISH_TOLERANCE
from cubicsplat_cli.progress import Work, under_way
from cubicsplat_cli.raster.cpu import CpuEngine
from cubicsplat_cli.raster.engine import Pass
from cubicsplat_cli.raster.engines import render_scene
from cubicsplat_cli.raster.settings import RasterSettings
from cubicsplat_cli.scene import Scene
from cubicsplat_cli.settings import FitSettings, Mode
from cubicsplat_cli.svg.moving import to_grid_clip
from cubicsplat_cli.svg.moving_file import write_clip

WHITE = (1.0, 1.0, 1.0)
QUICK = FitSettings.from_preset("draft", curves=2, steps=120, threads=1, background="#e6e6cc")


def disc(x: float, y: float, size: int = 24, radius: float = 6.0) -> np.ndarray:
    """A dark disc on a light ground, with smooth edges."""
    rows, columns = np.mgrid[:size, :size] + 0.5
    inside = np.clip(radius + 0.5 - np.hypot(columns - x, rows - y), 0.0, 1.0)[..., None]
    return (inside * [0.1, 0.2, 0.6] + (1.0 - inside) * [0.9, 0.9, 0.8]).astype(np.float32)


def fitted(pictures: list[np.ndarray], **changes: object) -> list[Tracks]:
    settings = FitSettings.from_preset(
        "draft", **{"curves": 2, "steps": 150, "threads": 1, "background": "#e6e6cc", **changes}
    )
    frames = [(picture, 0.1 * index, 0.1 * (index + 1)) for index, picture in enumerate(pictures)]
    return fit_clip(iter(frames), settings, len(frames))


def place(scene: Scene) -> np.ndarray:
    """(2,): x and y of the middle of what is dark."""
    dark = (0.9 - render_scene(scene, threads=1)[..., 0]).clip(0.0)
    rows, columns = np.mgrid[: scene.height, : scene.width] + 0.5
    return np.array([(dark * columns).sum(), (dark * rows).sum()]) / dark.sum()


def test_a_moving_disc_is_followed_within_tenths_of_a_pixel() -> None:
    places = [(8.0 + 1.1 * frame, 9.0 + 0.7 * frame) for frame in range(7)]
    (group,) = fitted([disc(*each) for each in places])
    assert group.frames == len(places)
    for frame, wanted in enumerate(places):
        assert place(scene_at(group, frame)) == pytest.approx(wanted, abs=0.2)
    # It moves at one speed, which takes no knot between the ends.
    shapes = group.by_name["shapes"]
    assert shapes.count <= 2.5 * shapes.knots.shape[1]


def test_a_still_clip_has_two_equal_knots_a_curve() -> None:
    (group,) = fitted([disc(10.0, 12.0)] * 5)
    first, last = scene_at(group, 0), scene_at(group, 4)
    for track in group.by_name.values():
        assert (track.still | (track.knots.sum(axis=0) == 2)).all()
    for name in ("points", "colours", "opacities"):
        assert (getattr(first, name) == getattr(last, name)).all()


def test_a_cut_begins_a_new_group_of_curves() -> None:
    first, second = disc(8.0, 8.0), 1.0 - disc(14.0, 15.0)
    clip = fitted([first, first, second, second])
    assert [group.frames for group in clip] == [2, 2]
    assert clip[0].end == clip[1].times[0]


def test_groups_end_at_cuts_and_where_memory_does_and_read_no_frame_ahead_of_need() -> None:
    read = []

    def frames() -> itertools.chain:
        for index in range(9):
            read.append(index)
            yield disc(5.0 + index, 12.0), float(index), index + 1.0

    found = groups(frames(), 4)
    assert len(next(found).pictures) == 4
    assert read == [0, 1, 2, 3, 4]
    rest = list(found)
    assert [len(group.pictures) for group in rest] == [4, 1]
    assert not any(group.after_cut for group in rest)


def test_an_interrupt_keeps_the_frames_so_far() -> None:
    pictures = [disc(8.0 + frame, 12.0) for frame in range(6)]
    with under_way(Work(ctrl_c_when(lambda progress: progress.stage == "frame 4"))) as work:
        (group,) = fitted(pictures, steps=40)
    assert work.interrupted
    assert group.frames == 3
    assert group.end == pytest.approx(0.3)


def test_a_stop_before_the_joint_fit_leaves_a_clip_that_can_be_drawn() -> None:
    with under_way(Work(ctrl_c_when(lambda progress: progress.stage == "moving curves"))):
        (group,) = fitted([disc(8.0 + frame, 12.0) for frame in range(8)], curves=12, steps=60)
    for frame in range(8):
        scene_at(group, frame).validate()


def test_a_deadline_makes_steps_fewer_before_it_makes_frames_fewer() -> None:
    pictures = [disc(8.0 + frame, 12.0) for frame in range(6)]
    began = time.perf_counter()
    with under_way(Work(deadline=began + 0.6)):
        (group,) = fitted(pictures, steps=20_000)
    assert time.perf_counter() - began < 3.0
    assert group.frames == 6


def test_a_group_goes_on_with_the_curves_that_the_one_before_shows_at_its_end() -> None:
    pictures = [disc(8.0 + frame, 12.0) for frame in range(7)]
    settings = FitSettings.from_preset("draft", curves=3, steps=150, threads=1, background="#e6e6cc")
    fit = ClipFit(pictures[0], settings, precision=1, bytes_per_second=math.inf, count=7)
    first = fit.group(FrameGroup(after_cut=True, pictures=pictures[:4], times=[0.0, 0.1, 0.2, 0.3], end=0.4), None)
    last = scene_at(first, 3)
    shown = render_scene(last, threads=1)
    gone = [
        replace(last, opacities=np.where(np.arange(3) == curve, np.float32(0.0), last.opacities)) for curve in range(3)
    ]
    dead = min(gone, key=lambda scene: float(np.square(render_scene(scene, threads=1) - shown).sum()))
    second = fit.group(FrameGroup(after_cut=False, pictures=pictures[4:], times=[0.4, 0.5, 0.6], end=0.7), dead)
    assert second.scene.curves == 3
    assert place(scene_at(second, 2)) == pytest.approx((14.0, 12.0), abs=0.3)


def test_a_picture_that_moves_carries_the_curves_with_it() -> None:
    # No step of a fit would find a disc that lies beside the curves.
    settings = QUICK.with_(curves=6)
    follower = Follower(FitLoop(disc(12.0, 16.0, 48, 4.0), settings, opened=lambda *_, **__: CpuEngine(1)))
    follower.first()
    follower.follow(disc(17.0, 20.0, 48, 4.0), steps=0, frames_left=1)
    assert place(follower.scenes[0]) == pytest.approx((12.0, 16.0), abs=0.5)
    assert place(follower.scenes[1]) == pytest.approx((17.0, 20.0), abs=1.5)


def test_what_comes_into_a_clip_near_its_end_gets_curves() -> None:
    before = disc(8.0, 9.0, 48)
    after = np.minimum(before, disc(38.0, 38.0, 48, 5.0))
    settings = QUICK.with_(curves=16)
    follower = Follower(FitLoop(before.copy(), settings, opened=lambda *_, **__: CpuEngine(1)))
    follower.first()
    for left in range(7, 0, -1):
        picture = after if left <= 3 else before
        follower.follow(picture * np.float32(1.0 - 1e-3 * left), steps=30, frames_left=left)
    shown = render_scene(follower.rows()[-1], threads=1)
    assert np.abs(shown - after)[34:42, 34:42].mean() < 0.15


@pytest.mark.parametrize("channels", [3, 4])
def test_flow_is_the_shift_of_each_place(channels: int) -> None:
    rows, columns = np.mgrid[:40, :61]

    def waves(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        values = 0.5 + 0.2 * np.sin(x / 3.0) + 0.2 * np.cos(y / 4.0 + x / 7.0)
        return np.repeat(values[..., None], channels, axis=2).astype(np.float32)

    found = flow(waves(columns, rows), waves(columns - 2.3, rows + 1.6))
    inside = found[6:-6, 6:-6]
    assert found.shape == (40, 61, 2)
    assert np.abs(np.median(inside, axis=(0, 1)) - (2.3, -1.6)).max() < 0.1
    assert np.abs(inside - (2.3, -1.6)).mean() < 0.2


@pytest.mark.parametrize("size", [(1, 1), (1, 40), (33, 2)])
def test_still_pictures_of_any_size_have_no_flow(size: tuple[int, int]) -> None:
    picture = np.random.default_rng(0).random((*size, 3)).astype(np.float32)
    assert np.abs(flow(picture, picture)).max() < 1e-5


def test_places_between_pixels_have_values_between_theirs() -> None:
    picture = np.arange(12.0, dtype=np.float32).reshape(3, 4, 1)
    x, y = np.array([0.5, 3.0, 9.0, -2.0]), np.array([0.0, 1.5, 2.0, 0.25])
    assert sampled(picture, x, y)[:, 0] == pytest.approx([0.5, 9.0, 11.0, 1.0])


def test_a_curve_without_opacity_is_not_drawn_and_stays_so() -> None:
    tracks = random_tracks(np.random.default_rng(2), every=True)
    opacities = tracks.by_name["opacities"].values
    opacities[2:, 1] = 0.0
    shapes = tracks.by_name["shapes"].values
    before = shapes.copy()
    scene, seen = tracks.at(3, tracks.lines())
    assert (scene.curves, seen.tolist()) == (2, [0, 2])
    frames = [np.full((20, 20, 3), 0.5, np.float32)] * 5
    joint = JointFit(tracks, frames, CpuEngine(1), RasterSettings("exact", 1.0, 12))
    joint.run(3, (0.1, 0.1), np.random.default_rng(0), joint.raster, 0.0)
    assert (opacities[2:, 1] == 0.0).all()
    moved = (shapes != before).any(axis=2)
    assert moved[:, [0, 2]].all()
    assert moved[:, 1].tolist() == [True, True, False, False, False]


def test_the_last_epochs_of_the_joint_fit_have_exact_coverage(monkeypatch: pytest.MonkeyPatch) -> None:
    relaxed, exact = RasterSettings("relaxed", 0.8, 12), RasterSettings("exact", 1.0, 12)
    used = []
    monkeypatch.setattr(JointFit, "step", lambda fit, frames, _: used.extend([fit.raster] * len(frames)))
    frames = [np.full((20, 20, 3), 0.5, np.float32)] * 2
    joint = JointFit(random_tracks(np.random.default_rng(2), frames=2), frames, CpuEngine(1), relaxed)
    joint.run(10, (0.1, 0.1), np.random.default_rng(0), exact, 0.2)
    assert used == [relaxed] * 16 + [exact] * 4


def test_polylines_are_as_coarse_as_the_soft_edge_hides_until_coverage_is_exact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    used = []
    draw = CpuEngine._draw

    def noted(engine: CpuEngine, name: str, scene: object, raster: RasterSettings, *rest: object) -> float:
        used.append(raster)
        return draw(engine, name, scene, raster, *rest)

    monkeypatch.setattr(CpuEngine, "_draw", noted)
    fitted([disc(8.0 + frame, 12.0) for frame in range(3)], steps=40)
    edge = QUICK.recipe.edge_end
    assert {raster.tolerance for raster in used if raster.coverage == "relaxed"} == {0.5 * edge}
    assert all(raster.tolerance <= FINISH_TOLERANCE for raster in used if raster.coverage == "exact")


def test_a_curve_that_is_there_for_a_few_frames_counts_as_much_in_these() -> None:
    generator = np.random.default_rng(4)
    tracks = random_tracks(generator, every=True)
    for track in tracks.by_name.values():
        track.values[:] = track.values[:1]
    raster, engine = RasterSettings("exact", 1.0, 12), CpuEngine(1)
    always = sensitivity(tracks, engine, raster, np.random.default_rng(0))
    tracks.by_name["opacities"].values[1:, 0] = 0.0  # the frontmost
    once = sensitivity(tracks, engine, raster, np.random.default_rng(0))
    for name in ("offsets", "colours"):
        assert once[name][0].sum() > 0.3 * always[name][0].sum()


def test_fewer_bytes_leave_fewer_knots() -> None:
    generator = np.random.default_rng(1)
    tracks = random_tracks(generator, frames=8, every=True)
    weights = {name: np.ones(track.values.shape[1:]) for name, track in tracks.by_name.items()}
    there = np.ones((8, 3), bool)
    counts = [
        sum(track.count for track in choose(tracks, weights, there, 0.0, most).by_name.values())
        for most in (math.inf, 500.0, 0.0)
    ]
    assert counts[0] > counts[1] > counts[2] == 0


def test_knots_take_the_bytes_that_gzip_leaves_of_them() -> None:
    generator = np.random.default_rng(6)
    scenes = [
        Scene(
            Mode.CLOSED, 176, 144, (88.0 + 12.0 * generator.standard_normal((60, 12, 2))).astype(np.float32),
            generator.random((60, 3)).astype(np.float32), generator.random(60).astype(np.float32),
            np.zeros(60, np.float32), WHITE,
        )
        for _ in range(13)
    ]  # fmt: skip
    tracks = Tracks.on_every_frame(scenes, np.arange(13) / 13, 1.0)
    tracks.by_name["offsets"].values[1:] = 10.0 * generator.standard_normal((12, 60, 2))
    for track in tracks.by_name.values():
        track.knots[1:-1], track.still[:] = generator.random((11, 60)) < 0.5, True

    def size() -> int:
        return len(gzip.compress(write_clip(to_grid_clip([tracks], 1)).encode(), 9, mtime=0))

    standing = size()
    assert 60 * curve_bytes(tracks) == pytest.approx(standing, rel=0.25)
    for name, track in tracks.by_name.items():
        track.still[:] = False
        wanted = 60 * START_BYTES + knot_bytes(name, track.values.shape[2]) * (track.count - 60)
        assert size() - standing == pytest.approx(wanted, rel=0.25)
        track.still[:] = True


@pytest.mark.parametrize(("worth", "moves"), [(0.15, False), (0.8, True)])
def test_what_knots_take_away_is_worth_their_share_of_the_bytes(worth: float, moves: bool) -> None:
    # Beside three curves that stand still, the knots of one take 0.4 of all bytes.
    tracks = random_tracks(np.random.default_rng(1), frames=3, every=True)
    for track in tracks.by_name.values():
        track.values[:] = track.values[:1]
    tracks.by_name["shapes"].values[1, 0, 0] += 1.0
    weights = {name: np.ones(track.values.shape[1:]) for name, track in tracks.by_name.items()}
    loss = 2 / 3 / worth  # a curve that stands at the mean of 0, 1 and 0 is wrong by 2 / 3
    chosen = choose(tracks, weights, np.ones((3, 3), bool), loss, math.inf)
    assert (~chosen.by_name["shapes"].still).tolist() == [moves, False, False]


def random_tracks(generator: np.random.Generator, frames: int = 5, *, every: bool = False) -> Tracks:
    scenes = []
    for _ in range(frames):
        middles = 4.0 + 12.0 * generator.random((3, 1, 2))
        angles = np.arange(6) / 6 * 2 * np.pi
        ring = 5.0 * np.stack([np.cos(angles), np.sin(angles)], axis=-1)
        points = (middles + ring + generator.random((3, 6, 2))).astype(np.float32)
        colours, opacities = generator.random((3, 3)), 0.3 + 0.5 * generator.random(3)
        scenes.append(
            Scene(
                Mode.CLOSED, 20, 20, points, colours.astype(np.float32), opacities.astype(np.float32),
                np.zeros(3, np.float32), WHITE,
            )
        )  # fmt: skip
    tracks = Tracks.on_every_frame(scenes, np.cumsum(0.1 + generator.random(frames)), 99.0)
    for track in () if every else tracks.by_name.values():
        track.knots[1:-1] = generator.random((frames - 2, 3)) < 0.5
        track.still[0] = generator.random() < 0.5
    return tracks


@pytest.mark.parametrize("name", ["shapes", "offsets", "colours", "opacities"])
def test_the_gradient_of_knots_is_that_of_all_frames_together(name: str) -> None:
    generator = np.random.default_rng(7)
    tracks = random_tracks(generator)
    frames = [generator.random((20, 20, 3)).astype(np.float32) for _ in range(tracks.frames)]
    raster = RasterSettings("relaxed", 2.0, 16)
    engine = CpuEngine(1)

    def loss() -> float:
        lines = tracks.lines()
        scenes = (tracks.at(frame, lines)[0] for frame in range(tracks.frames))
        return sum(engine.loss(scene, raster, Pass(wanted)) for scene, wanted in zip(scenes, frames, strict=True))

    track = tracks.by_name[name]
    sums, touched = np.zeros_like(track.values), np.zeros(track.knots.shape, bool)
    for frame in range(tracks.frames):
        joint = JointFit(tracks, frames, engine, raster)
        joint.step(np.array([frame]), np.zeros((1, 2)))
        means, _, ages = joint.moments[name]
        sums += means / (1.0 - KEEP_MEAN)
        touched |= ages > 0
    direction = (generator.standard_normal(track.values.shape) * touched[..., None]).astype(np.float32)
    if name == "shapes":
        direction[..., -1] = 0.0  # closed curves have no width
    wanted, h, before = float((sums * direction).sum()), 2e-3, track.values.copy()
    track.values[...] = before + h * direction
    more = loss()
    track.values[...] = before - h * direction
    assert (more - loss()) / (2 * h) == pytest.approx(wanted, rel=0.03, abs=0.05)


def test_steps_of_knots_are_those_of_adam() -> None:
    generator, rate = np.random.default_rng(8), 0.03
    tracks, target = random_tracks(generator, every=True), generator.random((20, 20, 3)).astype(np.float32)
    track = tracks.by_name["opacities"]
    track.values[2:, 1] = 0.0
    engine, raster = CpuEngine(1), RasterSettings("exact", 1.0, 12)
    joint = JointFit(tracks, [target] * tracks.frames, engine, raster)
    lines, mean, square = joint.lines["opacities"], np.zeros(3), np.zeros(3)
    wanted = track.values[3, :, 0].astype(float)
    for age in (1, 2, 3):
        scene, seen = tracks.at(3, joint.lines)
        gradient = np.zeros(3)
        gradient[seen] = engine.gradients(scene, raster, target=target)[1]["opacities"]
        joint.step(np.array([3]), np.array([[0.01, rate]]))
        mean = KEEP_MEAN * mean + (1.0 - KEEP_MEAN) * gradient
        square = KEEP_SQUARE * square + (1.0 - KEEP_SQUARE) * gradient**2
        step = mean / (1.0 - KEEP_MEAN**age) / np.sqrt(square / (1.0 - KEEP_SQUARE**age) + 1e-30)
        wanted = np.where([True, False, True], (wanted - rate * step).clip(0.0, 1.0), 0.0)
    assert lines.share[3].tolist() == [0.0, 0.0, 0.0]
    assert track.values[3, :, 0] == pytest.approx(wanted, abs=1e-4)


@pytest.mark.parametrize("price", [0.0, 0.02, 0.3, 50.0])
def test_knots_are_those_of_the_least_error_and_price(price: float) -> None:
    generator = np.random.default_rng(3)
    times = np.cumsum(0.1 + generator.random(6))
    values, there = generator.random((6, 1, 2)).astype(np.float32), np.ones((6, 1), bool)
    track = KnotTrack(values, there.copy(), np.zeros(1, bool))
    choice = Choice(track, np.array([[1.0, 2.0]]), there, times)
    found, error = choice.at(price, 1e9 if price > 10 else -1e9)

    def cost(inner: tuple[int, ...]) -> float:
        at = [0, *inner, 5]
        path = np.stack([np.interp(times, times[at], values[at, 0, c]) for c in range(2)], axis=1)
        return float((np.square(path - values[:, 0]) * [1.0, 2.0]).sum())

    every = [inner for count in range(5) for inner in itertools.combinations(range(1, 5), count)]
    best = min(every, key=lambda inner: cost(inner) + price * len(inner))
    if price > 10:
        assert found.still.all()
        return
    assert tuple(np.flatnonzero(found.knots[1:-1, 0]) + 1) == best
    assert error == pytest.approx(cost(best), abs=1e-6)


def test_fitted_knots_are_the_least_squares_of_the_path() -> None:
    generator = np.random.default_rng(5)
    times = np.cumsum(0.1 + generator.random(7))
    values, there = generator.random((7, 2, 1)).astype(np.float32), np.ones((7, 2), bool)
    track = KnotTrack(
        values, np.array([[1, 1], [0, 1], [1, 0], [0, 0], [0, 1], [0, 0], [1, 1]], bool), np.zeros(2, bool)
    )
    found = Choice(track, np.ones((2, 1)), there, times).fitted(track)
    whole = np.stack([found.lines(times).at(found.values, frame) for frame in range(7)])
    for curve in range(2):
        at = np.flatnonzero(track.knots[:, curve])
        hats = np.stack([np.interp(times, times[at], row) for row in np.eye(len(at))], axis=1)
        wanted = hats @ np.linalg.lstsq(hats, values[:, curve, 0], rcond=None)[0]
        assert whole[:, curve, 0] == pytest.approx(wanted, abs=1e-5)
