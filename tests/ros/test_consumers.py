"""Every topic as its usual consumers subscribe to it, at several speeds, and across pauses, steps and resets.

The table is ``support.consumers``. Tests of one speed share a simulation; each leaves it playing.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulation import Launched, Listener, require

require("rclpy", "gibson_msgs", "simulation_interfaces")

from diagnostic_msgs.msg import DiagnosticArray  # noqa: E402
from nav_msgs.msg import OccupancyGrid, Odometry  # noqa: E402
from rosgraph_msgs.msg import Clock  # noqa: E402
from sensor_msgs.msg import LaserScan, PointCloud2  # noqa: E402
from simulation_interfaces.msg import SimulationState  # noqa: E402
from simulation_interfaces.srv import ResetSimulation  # noqa: E402
from tf2_msgs.msg import TFMessage  # noqa: E402

from gibson_msgs.msg import Epoch  # noqa: E402
from gibson_sim.geometry.transforms import matrix_from_pose  # noqa: E402
from gibson_sim.ros.client.simulation_client import SimulationClient  # noqa: E402
from gibson_sim.ros.conversions import pose_from_msg  # noqa: E402
from support.clients import DEEP, LATCHED, client_of, drive_until, stamp_ns, step_of, steps_of  # noqa: E402
from support.consumers import CLOCK, LATCHED_ROWS, STREAMS, TICK, Heard, Row, hear  # noqa: E402
from support.maps import cells_of, cells_to_occupied, fixed_transform, hits_of, rows_columns  # noqa: E402
from support.robots import write_gibson_bot  # noqa: E402

pytestmark = pytest.mark.ros
REAL_TIME, SLOW, FAST = ("--rate", "1"), ("--rate", "0.3"), ("--rate", "3", "--no-render")
"""Nothing is drawn at a high speed: what a slow machine can draw is for another test."""
ENOUGH = 6
"""Messages of each stream."""
SOON = 240
"""Physics steps after a reset in which every stream is due."""
START = (1.0, 4.7)
"""In the hall of our flat, facing along x."""


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """gibson_bot with a small camera that every machine can draw."""
    return write_gibson_bot(tmp_path_factory.mktemp("robot"), camera={"width": 64, "height": 48, "rate_hz": 10.0})


def _name(options: tuple[str, ...]) -> str:
    return "_".join(option.removeprefix("--") for option in options if option != "--no-render")


@pytest.fixture(scope="module", params=[REAL_TIME, SLOW, FAST], ids=_name)
def sim(ros_domain: int, robot: Path, request: pytest.FixtureRequest) -> Iterator[Launched]:
    """A simulation; there can be one at a time, so tests that need another one name its options."""
    start = f"{START[0]},{START[1]},0"
    launched = Launched("run", "--robot", str(robot), "--start", start, *request.param)
    launched.wait_for_line("collision shapes" if "--no-render" in request.param else "triangles")
    yield launched
    assert launched.stop() == 0, "\n".join(launched.lines)


def _options(*options: str) -> pytest.MarkDecorator:
    return pytest.mark.parametrize("sim", [options], indirect=True, ids=_name, scope="module")


@pytest.fixture(scope="module")
def heard(sim: Launched, ros_context: Any) -> dict[str, Heard]:
    """What the consumers of one simulation received, all of them at a time, by consumer and topic."""
    client = Listener(ros_context)
    found = hear(client, [row for row in STREAMS if _is_drawn(sim) or not row.rendered], ENOUGH)
    client.close()
    return found


@pytest.fixture
def control(sim: Launched, listener: Listener) -> Iterator[SimulationClient]:
    """The services of the simulation; afterwards it plays again."""
    services = client_of(listener)
    yield services
    services.play()


every_latched = pytest.mark.parametrize("wanted", LATCHED_ROWS, ids=lambda row: row.topic)
in_real_time = pytest.mark.parametrize("sim", [REAL_TIME], indirect=True, ids=_name, scope="module")
"""For facts that hold at every speed."""


def test_consumers_receive_with_their_own_quality_of_service(heard: dict[str, Heard]) -> None:
    assert len(heard) >= sum(not row.rendered for row in STREAMS)
    assert {who: len(found.messages) for who, found in heard.items() if len(found.messages) < ENOUGH} == {}


def test_topics_have_one_type_and_it_is_the_expected_one(heard: dict[str, Heard]) -> None:
    assert {who: found.types for who, found in heard.items() if found.types != [found.row.type_name]} == {}


def test_topics_have_one_publisher(heard: dict[str, Heard]) -> None:
    assert {who: found.publishers for who, found in heard.items() if found.publishers != 1} == {}


def test_stamps_come_at_the_steps_at_which_the_rate_is_due(heard: dict[str, Heard]) -> None:
    for who, found in heard.items():
        steps = steps_of(found.messages)
        # A busy machine loses or skips some: some may be missing, but none may lie in between, and two are neighbours.
        assert set(steps) <= found.row.due_steps(steps[-1]), who
        assert min(np.diff(steps)) == pytest.approx(240 / found.row.rate_hz, abs=1.0), who


def test_frames_are_those_of_the_conventions(heard: dict[str, Heard]) -> None:
    for who, found in heard.items():
        parts = [m.transforms[0] if isinstance(m, TFMessage) else m for m in found.messages]
        assert {m.header.frame_id for m in parts} == {found.row.frame}, who
        if found.row.child:
            assert {m.child_frame_id for m in parts} == {found.row.child}, who


def test_no_message_is_sent_before_the_clock_of_its_stamp(heard: dict[str, Heard]) -> None:
    wrong = {who: _sent_too_late(found, found.clock, reach=3) for who, found in heard.items()}
    assert {who: late for who, late in wrong.items() if late} == {}


def test_no_message_is_sent_before_the_transform_of_its_stamp(heard: dict[str, Heard]) -> None:
    wrong = {who: _sent_too_late(found, found.transforms, reach=TICK) for who, found in heard.items() if found.row.placed}
    assert wrong
    assert {who: late for who, late in wrong.items() if late} == {}


def _sent_too_late(heard: Heard, stamps: dict[int, int], reach: int) -> list[str]:
    """Returns what is wrong with messages of another topic that should be there, by step, before those that were received.

    A busy machine may lose some of the other topic: then those within ``reach`` steps, of which there must be some, are missing too.
    """
    others = {step_of(stamp): sent for stamp, sent in stamps.items()}
    wrong, judged = [], 0
    for step, sent in zip(steps_of(heard.messages), heard.sent_ns, strict=True):
        near = [any(step + sign * i in others for i in range(1, reach + 1)) for sign in (-1, 1)]
        judged += step in others or all(near)
        if step in others and others[step] > sent:
            wrong.append(f"step {step}: {(others[step] - sent) / 1e6:.3f} ms later")
        elif step not in others and all(near):
            wrong.append(f"step {step}: never")
    assert judged, f"nothing of the other topic was received near any of the messages on {heard.row.topic}"
    return wrong


def test_imu_lies_between_two_transforms_of_neighbouring_ticks(heard: dict[str, Heard]) -> None:
    found = heard["robot_localization: imu"]
    ticks = sorted(map(step_of, found.transforms))
    bracketed = [step for step in steps_of(found.messages) if step - step % TICK in ticks and step + (-step) % TICK in ticks]
    # The others were sent before transforms were received, or on a machine so busy that it lost some.
    assert len(bracketed) >= ENOUGH // 2


@every_latched
def test_late_subscriber_receives_latched_messages(sim: Launched, listener: Listener, wanted: Row) -> None:
    messages = listener.collect(wanted.kind, wanted.topic, wanted.qos)
    listener.spin_until(lambda: bool(messages), f"{wanted.topic} for {wanted.who}")
    assert dict(listener.node.get_topic_names_and_types())[wanted.name] == [wanted.type_name]
    if wanted.frame:
        assert messages[0].header.frame_id == wanted.frame


def test_clock_rises_for_a_best_effort_reader_that_keeps_one(sim: Launched, listener: Listener) -> None:
    clock = listener.collect(Clock, "/clock", CLOCK)
    listener.spin_until(lambda: len(clock) > 30, "time")
    steps = steps_of(clock)
    assert steps == sorted(set(steps))


def test_velocity_can_be_sent_as_either_type(sim: Launched, listener: Listener) -> None:
    def types() -> set[str]:
        return set(dict(listener.node.get_topic_names_and_types()).get("/cmd_vel", []))

    listener.spin_until(lambda: types() == {"geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped"}, "both types of cmd_vel")


def test_scan_is_that_of_the_lds(sim: Launched, listener: Listener) -> None:
    scans = listener.collect(LaserScan, "scan")
    listener.spin_until(lambda: bool(scans), "a scan")
    scan = scans[0]
    assert len(scan.ranges) == 360
    assert scan.angle_min == 0.0
    assert scan.angle_increment == pytest.approx(2 * math.pi / 360)
    assert scan.angle_max == pytest.approx(2 * math.pi * 359 / 360)
    assert (scan.range_min, scan.range_max) == (pytest.approx(0.12), pytest.approx(12.0))
    assert (scan.time_increment, scan.scan_time) == (0.0, pytest.approx(0.1)), "all rays are cast at the stamp"
    assert not np.isnan(scan.ranges).any()


def _velocity(a: Odometry, b: Odometry) -> NDArray[np.float64]:
    """Returns the mean velocity between two odometries, (2,), m/s, in the odometry's frame."""
    moved = np.array([b.pose.pose.position.x - a.pose.pose.position.x, b.pose.pose.position.y - a.pose.pose.position.y])
    return moved * 1e9 / (stamp_ns(b) - stamp_ns(a))


def _yaw(message: Odometry) -> float:
    q = message.pose.pose.orientation
    return 2 * math.atan2(q.z, q.w)


@in_real_time
@pytest.mark.parametrize("topic", ["odom", "ground_truth/odom"])
def test_twist_of_odometry_is_in_the_child_frame(
    sim: Launched, listener: Listener, control: SimulationClient, topic: str
) -> None:
    control.reset(ResetSimulation.Request.SCOPE_STATE)
    odometry = listener.collect(Odometry, topic, DEEP)
    listener.spin_until(lambda: bool(odometry), topic)

    def moves_along_y(i: int) -> bool:
        return abs(_yaw(odometry[i]) - math.pi / 2) < 0.2 and odometry[i].twist.twist.linear.x > 0.1

    drive_until(listener, "cmd_vel", 0.2, 0.5, lambda: len(odometry) > 4 and moves_along_y(-3), "a robot that moves along y")
    at = next(i for i in range(2, len(odometry)) if moves_along_y(i))
    now, moved = odometry[at], _velocity(odometry[at - 2], odometry[at + 2])
    assert abs(moved[1]) > 3 * abs(moved[0]), "it moves along y of the odometry's frame"
    yaw, twist = _yaw(now), now.twist.twist
    ahead, left = moved @ [math.cos(yaw), math.sin(yaw)], moved @ [-math.sin(yaw), math.cos(yaw)]
    assert (twist.linear.x, twist.linear.y) == (pytest.approx(ahead, abs=0.02), pytest.approx(left, abs=0.02))


def test_map_is_free_where_the_robot_starts(sim: Launched, listener: Listener) -> None:
    maps = listener.collect(OccupancyGrid, "map", LATCHED)
    listener.spin_until(lambda: bool(maps), "the map")
    grid = maps[0]
    assert grid.info.resolution == pytest.approx(0.05)
    ((r, c),) = rows_columns(grid, np.array([START]))
    assert (cells_of(grid)[r - 1 : r + 2, c - 1 : c + 2] == 0).all()


def test_walls_of_the_map_are_where_the_scan_hits(sim: Launched, listener: Listener) -> None:
    maps = listener.collect(OccupancyGrid, "map", LATCHED)
    statics = listener.collect(TFMessage, "/tf_static", LATCHED)
    scans, truth = listener.collect(LaserScan, "scan", DEEP), listener.collect(Odometry, "ground_truth/odom", DEEP)

    def poses() -> dict[int, Odometry]:
        return {stamp_ns(t): t for t in truth}

    listener.spin_until(lambda: bool(maps and statics) and any(stamp_ns(s) in poses() for s in scans), "map, scan and pose")
    scan = next(s for s in scans if stamp_ns(s) in poses())
    T_map_base = matrix_from_pose(pose_from_msg(poses()[stamp_ns(scan)].pose.pose))
    T_base_scan, points = fixed_transform(statics[0], "base_footprint", "base_scan"), hits_of(scan)
    assert len(points) > 300, "inside a flat nearly every ray meets something"
    in_map = (points @ (T_map_base @ T_base_scan).T)[:, :2]
    assert (cells_to_occupied(maps[0], in_map) <= 2).mean() >= 0.95


def test_localiser_alone_connects_map_and_odom(sim: Launched, listener: Listener) -> None:
    moving, static = listener.collect(TFMessage, "/tf", DEEP), listener.collect(TFMessage, "/tf_static", LATCHED)
    listener.spin_until(lambda: len(moving) > 3 and bool(static), "transforms")
    assert not [t for m in (*moving, *static) for t in m.transforms if t.header.frame_id == "map" or t.child_frame_id == "odom"]


def _streams(listener: Listener, drawn: bool) -> dict[str, list[Any]]:
    """Returns everything that has stamps, as lists that fill."""
    rows = {row.topic: row for row in STREAMS if drawn or not row.rendered}
    # A cloud takes longer to receive than all the rest.
    streams = {name: listener.collect(row.kind, name, DEEP) for name, row in rows.items() if row.kind is not PointCloud2}
    streams["/clock"] = listener.collect(Clock, "/clock", DEEP)
    listener.spin_until(lambda: all(streams.values()), "a message on every topic")
    return streams


def _is_drawn(sim: Launched) -> bool:
    return any("triangles" in line for line in sim.lines)


def test_nothing_is_published_while_time_stands_still(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    streams = _streams(listener, _is_drawn(sim))
    reports = listener.collect(DiagnosticArray, "/diagnostics")
    control.pause()
    # Diagnostics come by wall time: what was under way has arrived with the first, and a second passes until the others.
    for _ in range(2):
        for messages in (reports, *streams.values()):
            messages.clear()
        listener.spin_until(lambda: len(reports) > 2, "diagnostics of a paused simulation")
    assert {name: len(messages) for name, messages in streams.items() if messages} == {}


def test_pause_sets_the_paused_state(sim: Launched, control: SimulationClient) -> None:
    control.pause()
    assert control.state == SimulationState.STATE_PAUSED


@in_real_time
@pytest.mark.parametrize("steps", [1, 7, 24])
def test_step_runs_the_requested_physics_steps_and_publishes_all_that_is_due(
    sim: Launched, listener: Listener, control: SimulationClient, steps: int
) -> None:
    control.pause()
    clock, odometry = listener.collect(Clock, "/clock", DEEP), listener.collect(Odometry, "odom", DEEP)
    scans = listener.collect(LaserScan, "scan", DEEP)
    publishers = ("/clock", "/odom", "/scan")
    listener.spin_until(lambda: all(listener.node.count_publishers(topic) for topic in publishers), "publishers")
    # The first steps are for the readers to be found by; they end where a scan has just been made.
    listener.spin_until(lambda: control.step(4) or bool(odometry and clock), "answers to steps")
    listener.spin_until(lambda: control.step(24) or bool(scans), "a scan")
    start = _settled(listener, clock)
    control.step(steps)
    listener.spin_until(lambda: step_of(stamp_ns(clock[-1])) >= start + steps, "time")
    assert _settled(listener, clock) == start + steps
    assert [s for s in steps_of(odometry) if s > start] == [s for s in range(start + 1, start + steps + 1) if s % 4 == 0]
    assert [s for s in steps_of(scans) if s > start] == [s for s in range(start + 1, start + steps + 1) if s % 24 == 0]


def _settled(listener: Listener, clock: list[Any]) -> int:
    """Returns the step of a paused simulation: what its clock says when it says nothing more."""
    reports = listener.collect(DiagnosticArray, "/diagnostics")
    listener.spin_until(lambda: len(reports) > 1, "two diagnostics")
    return step_of(stamp_ns(clock[-1]))


def test_reset_restarts_time_and_increments_the_epoch(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    epochs = listener.collect(Epoch, "simulation_epoch", LATCHED)
    streams = _streams(listener, _is_drawn(sim))
    listener.spin_until(lambda: bool(epochs), "the epoch")
    before = epochs[-1].epoch
    control.pause()
    reports = listener.collect(DiagnosticArray, "/diagnostics")
    listener.spin_until(lambda: len(reports) > 1, "the last of the old epoch")
    for messages in streams.values():
        messages.clear()
    control.reset()
    listener.spin_until(lambda: epochs[-1].epoch > before, "another epoch")
    assert (epochs[-1].epoch, epochs[-1].time_rewound, stamp_ns(epochs[-1])) == (before + 1, True, 0)
    # Time stands still behind these steps: a slow renderer draws at least their last image.
    control.step(SOON)
    listener.spin_until(lambda: all(streams.values()), "a message on every topic after the reset")
    due = {row.topic: row.due_steps(SOON) for row in STREAMS}
    for name, messages in streams.items():
        steps = steps_of(messages)
        # The very first may be lost, or an image skipped, where the machine is busy.
        assert steps[0] <= SOON, name
        assert steps[0] in due.get(name, {steps[0]}), name
        assert steps == sorted(set(steps)), name


def test_reset_puts_the_robot_back(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    truth = listener.collect(Odometry, "ground_truth/odom", DEEP)
    listener.spin_until(lambda: bool(truth), "ground truth")
    drive_until(listener, "cmd_vel", 0.0, 1.0, lambda: abs(_yaw(truth[-1])) > 0.5, "a turned robot")
    control.pause()
    control.reset()
    control.step(TICK)

    def first() -> list[Odometry]:
        return [message for message in truth if step_of(stamp_ns(message)) == TICK]

    listener.spin_until(lambda: bool(first()), "ground truth after the reset")
    position = first()[0].pose.pose.position
    assert (position.x, position.y) == (pytest.approx(START[0], abs=0.001), pytest.approx(START[1], abs=0.001))
    assert _yaw(first()[0]) == pytest.approx(0.0, abs=0.001)


@_options("--reset-time", "monotonic", "--no-render")
def test_monotonic_reset_never_turns_time_back(sim: Launched, listener: Listener, control: SimulationClient) -> None:
    streams, epochs = _streams(listener, drawn=False), listener.collect(Epoch, "simulation_epoch", LATCHED)
    listener.spin_until(lambda: bool(epochs) and step_of(stamp_ns(streams["/clock"][-1])) > 240, "a second")
    control.reset()
    listener.spin_until(lambda: epochs[-1].epoch == 1, "another epoch")
    counts = {name: len(messages) for name, messages in streams.items()}
    listener.spin_until(lambda: all(len(m) > counts[name] + 2 for name, m in streams.items()), "messages after the reset")
    assert not epochs[-1].time_rewound
    assert stamp_ns(epochs[-1]) > 10**9
    for name, messages in streams.items():
        steps = steps_of(messages)
        assert steps == sorted(set(steps)), name


localised = _options("--publish-map-tf", "--no-render")


@localised
def test_our_map_is_withdrawn_while_another_node_publishes_one(sim: Launched, listener: Listener) -> None:
    maps = listener.collect(OccupancyGrid, "map", LATCHED)
    listener.spin_until(lambda: bool(maps), "our map")
    publisher = listener.node.create_publisher(OccupancyGrid, "map", LATCHED)
    listener.spin_until(lambda: listener.node.count_publishers("map") == 2, "both maps")
    listener.spin_until(lambda: listener.node.count_publishers("map") == 1, "a map that gives way")
    sim.wait_for_line("ours is withdrawn")
    received = len(maps)
    listener.node.destroy_publisher(publisher)
    sim.wait_for_line("ours is published again")
    listener.spin_until(lambda: len(maps) > received, "our map again")
    assert maps[-1] == maps[0]


@localised
def test_perfect_localiser_can_be_enabled(sim: Launched, listener: Listener) -> None:
    moving = listener.collect(TFMessage, "/tf", DEEP)
    listener.spin_until(lambda: bool(moving), "transforms")
    (found,) = [t for t in moving[0].transforms if t.child_frame_id == "odom"]
    assert found.header.frame_id == "map"
    place = found.transform.translation
    assert (place.x, place.y) == (pytest.approx(START[0], abs=0.01), pytest.approx(START[1], abs=0.01))
