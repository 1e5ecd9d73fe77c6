"""Paths of a tiny room, recorded and followed in this process."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from gibson_path_following.types import STOP, Place, Velocity
from gibson_sim.errors import SceneError
from gibson_sim_learn.path_following.cases import PathCase, draw_cases, greatest_turn
from gibson_sim_learn.path_following.clutter import random_object
from gibson_sim_learn.path_following.domains import Conditions, domain_of, draw
from gibson_sim_learn.path_following.drives import (
    BlindDriver,
    Observation,
    OracleDriver,
    PathSite,
    RandomDriver,
    Recording,
    Tick,
    Trace,
    follow,
    oracle_for,
    record,
)
from gibson_sim_learn.path_following.layout import OBJECT_MODELS, Layout, draw_layout
from gibson_sim_learn.path_following.oracle import resampled
from support.scenes import write_room

LINE = ((-1.3, -1.2), (1.2, -1.2), (1.2, 1.2))
"""4.9 m, a corner of a right angle."""
STRAIGHT = ((-1.3, 0.0), (1.3, 0.0))


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Iterator[PathSite]:
    with PathSite(str(write_room(tmp_path_factory.mktemp("scenes") / "room"))) as opened:
        yield opened


@pytest.fixture(scope="module")
def recording(site: PathSite) -> Recording:
    return record(site, PathCase(site.scene, 4.9, 0, LINE))


class Steady:
    """Drives at one velocity."""

    needs_view = False
    place: Place | None = None
    state = "following"

    def __init__(self, linear: float) -> None:
        self.velocity = Velocity(linear, 0.0)

    def drive(self, observation: Observation) -> Velocity:
        return self.velocity


def steady(linear: float) -> Callable[[Layout], Steady]:
    return lambda _: Steady(linear)


def test_a_recording_has_a_node_every_twenty_centimetres_up_to_the_end(recording: Recording) -> None:
    distances = np.diff([node.distance for node in recording.path.nodes])
    assert distances.max() <= 0.25
    assert np.median(distances) == pytest.approx(0.2, abs=0.01)
    headings = np.unwrap([yaw for _, _, yaw in recording.poses])
    assert np.abs(np.diff(headings)).max() < math.radians(30.0)
    assert math.dist(recording.poses[-1][:2], LINE[-1]) < 0.1
    assert recording.path.nodes[0].view[0].shape == (64, 96, 3)
    assert all(node.velocities[0][0] == 0 for node in recording.path.nodes)


def test_equal_seeds_drive_equal_bits(site: PathSite, recording: Recording) -> None:
    conditions = draw(domain_of("reality"), np.random.default_rng(4))
    first, second = (
        follow(site, recording, lambda _: BlindDriver(recording), conditions, seed=5, keep_views=True) for _ in range(2)
    )
    assert [(t.stamp_ns, t.pose, t.command) for t in first.ticks] == [(t.stamp_ns, t.pose, t.command) for t in second.ticks]
    assert all(np.array_equal(a[0], b[0]) for a, b in zip(first.views, second.views, strict=True))
    other = follow(site, recording, lambda _: BlindDriver(recording), conditions, seed=6, keep_views=True)
    assert not np.array_equal(first.views[0][0], other.views[0][0])


def test_an_oracle_arrives_with_slip_bias_and_latency(site: PathSite, recording: Recording) -> None:
    conditions = Conditions(slip=0.7, yaw_bias=0.15, latency_ticks=2, start_left=0.1, start_yaw=math.radians(-8.0))
    trace = follow(site, recording, lambda layout: oracle_for(site, recording, layout, conditions), conditions, seed=0)
    outcome = trace.outcome(recording)
    assert outcome.success and outcome.coverage == 1.0
    assert trace.ended == "finished"


def test_an_oracle_goes_round_what_stands_on_the_path(site: PathSite, recording: Recording) -> None:
    conditions = Conditions(obstacles=1)
    trace = follow(site, recording, lambda layout: oracle_for(site, recording, layout, conditions), conditions, seed=2)
    assert trace.layout is not None and len(trace.layout.obstacles) == 1
    outcome = trace.outcome(recording)
    assert outcome.success and outcome.coverage == 1.0
    assert outcome.deviation_max > 0.15
    blind = follow(site, recording, lambda _: BlindDriver(recording), conditions, seed=2)
    assert blind.touched == trace.layout.obstacles
    assert not blind.outcome(recording).success


def test_a_wall_that_is_hit_is_a_collision_with_its_name(site: PathSite) -> None:
    straight = record(site, PathCase(site.scene, 2.6, 0, STRAIGHT))
    trace = follow(site, straight, steady(0.5), Conditions(), seed=0)
    assert trace.touched == ("front",)
    assert trace.ended == "standing"
    assert trace.outcome(straight).collisions >= 1


def test_slip_shortens_the_way_and_latency_delays_it(site: PathSite) -> None:
    straight = record(site, PathCase(site.scene, 2.6, 0, STRAIGHT))

    def driven(conditions: Conditions) -> list[float]:
        trace = follow(site, straight, steady(0.2), conditions, seed=0)
        return [tick.pose[0] - trace.ticks[0].pose[0] for tick in trace.ticks[:26]]

    plain, slipping, late = (driven(c) for c in (Conditions(), Conditions(slip=0.5), Conditions(latency_ticks=2)))
    assert plain[25] == pytest.approx(5.0 * 0.2, abs=0.05)
    assert slipping[25] == pytest.approx(plain[25] / 2.0, rel=0.06)
    assert max(late[:3]) < 1e-3 < late[3]
    assert late[25] == pytest.approx(plain[23], abs=0.01)


def test_standing_still_ends_the_drive(site: PathSite, recording: Recording) -> None:
    trace = follow(site, recording, steady(0.0), Conditions(), seed=0)
    assert trace.ended == "standing"
    assert trace.outcome(recording).coverage < 0.2


def test_places_are_compared_with_the_true_ones_while_they_are_followed(recording: Recording) -> None:
    middle = len(recording.poses) // 2

    def tick(node: int, index: float, state: str = "following") -> Tick:
        return Tick(0, recording.poses[node], STOP, False, index, state)

    ticks = [tick(k, k + 0.3) for k in range(middle)]
    ticks += [tick(middle, 0.0, "lost"), tick(middle, math.nan), tick(middle, middle - 2.0)]
    errors = Trace(tuple(ticks), "time").place_errors(recording)
    np.testing.assert_allclose(errors, [0.3] * middle + [2.0], atol=0.02)


def test_random_drives_are_random_by_their_seed(site: PathSite, recording: Recording) -> None:
    ends = [
        follow(site, recording, lambda _, seed=seed: RandomDriver(recording, np.random.default_rng(seed)), Conditions(), seed=0)
        for seed in (1, 1, 2)
    ]
    first, same, other = (trace.ticks[-1].pose for trace in ends)
    assert first == same != other


def test_a_watcher_sees_images_and_commands(site: PathSite, recording: Recording) -> None:
    seen: list[tuple[Observation, Velocity]] = []
    trace = follow(
        site,
        recording,
        lambda _: OracleDriver(recording.line),
        Conditions(),
        seed=0,
        on_tick=lambda observation, velocity: seen.append((observation, velocity)),
    )
    assert [velocity for _, velocity in seen] == [tick.command for tick in trace.ticks]
    assert seen[0][0].view[0].shape == (64, 96, 3)


def test_moved_objects_keep_their_clearance_from_the_path(site: PathSite, recording: Recording) -> None:
    layout = draw_layout(site.ground, recording.line, 3, 0, np.random.default_rng(0))
    assert 1 <= len(layout.moved) <= 3 and not layout.obstacles
    points, _ = resampled(recording.line)
    assert (layout.floor.clearance(points) >= site.ground.robot.radius + 0.1).all()
    assert len(layout.bodies) == len(site.ground.scene.bodies) + len(layout.moved)


def test_added_objects_are_those_of_the_given_maker(site: PathSite, recording: Recording) -> None:
    layout = draw_layout(site.ground, recording.line, 3, 1, np.random.default_rng(0), random_object)
    new = [body for body in layout.bodies if body.name in {*layout.moved, *layout.obstacles}]
    assert {body.name.rsplit("_", 1)[0] for body in new} == {"new", "on_path"}
    assert not any(model in str(body.model) for body in new for model in OBJECT_MODELS)
    for body in new:
        assert body.start.position[2] == pytest.approx(site.ground.floor.floor_z, abs=1e-4)


def test_a_start_in_a_wall_is_refused(site: PathSite, recording: Recording) -> None:
    layout = Layout(site.ground.scene.bodies, site.ground.floor)
    with pytest.raises(SceneError, match=r"robot touches front; start it elsewhere"):
        site.begin(layout, (1.79, 0.0, 0.0))


def test_paths_are_drawn_by_a_seed_with_their_length_and_a_turn(tmp_path: Path) -> None:
    wall = "  - {name: middle, box: [2.6, 0.2, 2.0], pose: {xyz: [-0.6, 0.0, 1.0]}, semantic_class: wall}\n"
    with PathSite(str(write_room(tmp_path / "walled", wall))) as walled:
        drawn, same = (draw_cases(walled.ground, walled.scene, 3.5, 2, seed=1) for _ in range(2))
        assert drawn == same
        for case in drawn:
            assert resampled(case.line)[1][-1] == pytest.approx(3.5, abs=1e-3)
            assert greatest_turn(case.line) >= math.radians(60.0)
        with pytest.raises(SceneError, match=r"room for 0 of 2 paths of 40 m"):
            draw_cases(walled.ground, walled.scene, 40.0, 2, seed=1)


def test_two_fisheyes_see_ahead_and_back(site: PathSite) -> None:
    rig = replace(site.rig, kind="fisheye_pair")
    site.begin(Layout(site.ground.scene.bodies, site.ground.floor), (0.0, 0.0, 0.0))
    cameras = rig.cameras(f"{site.ground.robot.name}/{site.ground.robot.base_link}", Conditions())
    front, back = (frame.rgb for frame in site.simulation.renderer.render(site.world.state(), cameras))
    assert front is not None and back is not None
    assert front.shape == back.shape == (96, 96, 3)
    assert front[48, 48].argmax() == 0  # the red wall
    assert back[48, 48].argmax() == 1  # the green one
