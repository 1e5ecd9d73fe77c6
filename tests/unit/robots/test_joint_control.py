"""Motor targets under joint commands. The joints here are ideal: each moves exactly at its motor's speed."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from gibson_sim.description.urdf import UrdfJoint
from gibson_sim.errors import CommandError
from gibson_sim.robots.joints.commands import JointCommand, JointPositions, JointTrajectory, JointVelocities, TrajectoryPoint
from gibson_sim.robots.joints.control import JointControl
from gibson_sim.types import Pose

S = 1_000_000_000
STEP_NS = S // 100
ARM = UrdfJoint("arm", "revolute", "a", "b", Pose(), (0.0, 1.0, 0.0), lower=-1.0, upper=2.0, effort=5.0, velocity=0.5)
LIFT = UrdfJoint("lift", "prismatic", "b", "c", Pose(), (0.0, 0.0, 1.0), lower=0.0, upper=0.3)
SPIN = UrdfJoint("spin", "continuous", "c", "d", Pose(), (0.0, 0.0, 1.0), effort=1.0)


class Bench:
    """Three joints with perfect motors, 100 steps a second."""

    def __init__(self) -> None:
        self.control = JointControl((ARM, LIFT, SPIN), ("wheel",))
        self.now_ns = 0
        self.positions = dict.fromkeys(self.control.names, 0.0)
        self.velocities = dict.fromkeys(self.control.names, 0.0)
        self.held: dict[str, float] = {}
        self.stuck: set[str] = set()

    def command(self, command: JointCommand) -> None:
        self.control.command(command, self.now_ns, self.positions, self.velocities)

    def run(self, seconds: float, watch: Callable[[], None] = lambda: None) -> None:
        for _ in range(round(seconds * 100)):
            targets = self.control.step(self.now_ns, STEP_NS, self.positions)
            for name, speed in targets.speeds.items():
                self.velocities[name] = 0.0 if name in self.stuck else speed
                self.held.pop(name, None)
            for name, position in targets.held.items():
                self.positions[name], self.velocities[name] = position, 0.0
                self.held[name] = position
            for name in targets.speeds:
                self.positions[name] += self.velocities[name] / 100
            self.now_ns += STEP_NS
            watch()


@pytest.fixture
def bench() -> Bench:
    return Bench()


def trajectory(*points: TrajectoryPoint, start_ns: int = 0, names: tuple[str, ...] = ("arm",)) -> JointTrajectory:
    return JointTrajectory(names, points, start_ns)


def test_position_is_reached_at_the_greatest_speed(bench: Bench) -> None:
    bench.command(JointPositions((1.0,), ("arm",)))
    bench.run(1.0)
    assert bench.positions["arm"] == pytest.approx(0.5)
    bench.run(1.1)
    assert bench.held == {"arm": 1.0}
    assert bench.control.active == ()


def test_joint_without_a_speed_goes_at_one_metre_a_second(bench: Bench) -> None:
    bench.command(JointPositions((0.3,), ("lift",)))
    bench.run(0.2)
    assert bench.positions["lift"] == pytest.approx(0.2)


def test_numbers_without_names_are_for_all_joints_in_their_order(bench: Bench) -> None:
    bench.command(JointPositions((0.1, 0.2, 0.3)))
    bench.run(1.0)
    assert bench.held == {"arm": 0.1, "lift": 0.2, "spin": 0.3}


def test_joint_that_was_held_back_does_not_rush_afterwards(bench: Bench) -> None:
    bench.stuck.add("arm")
    bench.command(JointPositions((1.0,), ("arm",)))
    bench.run(10.0)
    bench.stuck.clear()
    bench.run(0.5)
    assert bench.positions["arm"] == pytest.approx(0.25, abs=0.01)


def test_velocity_goes_on_until_it_is_zero(bench: Bench) -> None:
    bench.command(JointVelocities((-3.0,), ("spin",)))
    bench.run(4.0)
    assert bench.positions["spin"] == pytest.approx(-12.0)
    bench.command(JointVelocities((0.0,), ("spin",)))
    bench.run(0.1)
    assert bench.held == {"spin": pytest.approx(-12.0)}


def test_velocity_ends_at_a_limit_of_position(bench: Bench) -> None:
    bench.command(JointVelocities((-0.5,), ("arm",)))
    bench.run(5.0)
    assert bench.positions["arm"] == pytest.approx(-1.0)


def test_other_joints_keep_their_commands(bench: Bench) -> None:
    bench.command(JointVelocities((1.0,), ("spin",)))
    bench.command(JointPositions((0.1,), ("arm",)))
    bench.run(1.0)
    assert bench.positions["spin"] == pytest.approx(1.0)


def test_points_without_velocities_are_joined_by_straight_lines(bench: Bench) -> None:
    bench.command(trajectory(TrajectoryPoint(2 * S, (0.4,)), TrajectoryPoint(4 * S, (-0.4,))))
    places = []
    bench.run(4.0, lambda: places.append(bench.positions["arm"]))
    assert [places[i] for i in (99, 199, 299, 399)] == pytest.approx([0.2, 0.4, 0.0, -0.4], abs=1e-9)


def test_points_with_velocities_are_joined_by_a_cubic(bench: Bench) -> None:
    # From 0 at rest to 0.4 in 2 s at rest: 0.4 (3 u^2 - 2 u^3), u = t / 2.
    bench.command(trajectory(TrajectoryPoint(2 * S, (0.4,), (0.0,))))
    bench.run(0.5)
    assert bench.positions["arm"] == pytest.approx(0.4 * (3 / 16 - 2 / 64), abs=1e-9)
    bench.run(0.5)
    assert bench.positions["arm"] == pytest.approx(0.2, abs=1e-9)
    # The greatest speed, 1.5 times the mean.
    assert bench.velocities["arm"] == pytest.approx(0.3, abs=1e-3)


def test_points_with_accelerations_are_joined_by_a_quintic(bench: Bench) -> None:
    # From 0 to 0.4 in 2 s, at rest and without acceleration at both ends: 0.4 (10 u^3 - 15 u^4 + 6 u^5).
    bench.command(trajectory(TrajectoryPoint(2 * S, (0.4,), (0.0,), (0.0,))))
    bench.run(0.5)
    assert bench.positions["arm"] == pytest.approx(0.4 * (10 / 64 - 15 / 256 + 6 / 1024), abs=1e-9)


def test_quintic_meets_velocity_and_acceleration_at_its_end(bench: Bench) -> None:
    bench.command(trajectory(TrajectoryPoint(2 * S, (0.4,), (0.3,), (0.2,)), TrajectoryPoint(4 * S, (0.4,), (0.0,), (0.0,))))
    speeds = []
    bench.run(4.0, lambda: speeds.append(bench.velocities["arm"]))
    # A motor's speed is the mean over its step: 5 ms before the end, 0.3 - 0.2 * 0.005; 5 ms after it, 0.3 + 0.2 * 0.005.
    assert (speeds[199], speeds[200]) == pytest.approx((0.299, 0.301), abs=1e-4)


def test_curve_between_points_stays_within_the_limits(bench: Bench) -> None:
    # Both points are at the lower limit, but the curve swings below it.
    bench.command(trajectory(TrajectoryPoint(3 * S, (-1.0,), (-0.4,)), TrajectoryPoint(5 * S, (-1.0,), (0.4,))))
    lowest = []
    bench.run(5.0, lambda: lowest.append(bench.positions["arm"]))
    assert min(lowest) == pytest.approx(-1.0, abs=1e-9)


def test_trajectory_ends_in_holding_its_last_point(bench: Bench) -> None:
    bench.command(trajectory(TrajectoryPoint(S, (0.2,), (0.3,))))
    bench.run(1.1)
    assert bench.held == {"arm": 0.2}


def test_new_trajectory_starts_from_where_the_joint_is(bench: Bench) -> None:
    bench.command(trajectory(TrajectoryPoint(2 * S, (0.4,))))
    bench.run(1.0)
    bench.command(trajectory(TrajectoryPoint(S, (0.0,))))
    places = []
    bench.run(1.0, lambda: places.append(bench.positions["arm"]))
    assert (places[49], places[99]) == pytest.approx((0.1, 0.0), abs=1e-9)


def test_cubic_starts_with_the_speed_that_the_joint_has(bench: Bench) -> None:
    bench.command(JointVelocities((0.2,), ("arm",)))
    bench.run(1.0)
    bench.command(trajectory(TrajectoryPoint(S, (0.5,), (0.0,))))
    bench.run(0.01)
    # From 0.2 at 0.2 a second: after 5 ms 0.2 + (6 * 0.3 - 4 * 0.2) * 0.005
    assert bench.velocities["arm"] == pytest.approx(0.205, abs=1e-4)


def test_trajectory_without_points_stops_everything(bench: Bench) -> None:
    bench.command(JointVelocities((1.0,), ("spin",)))
    bench.command(JointPositions((1.0,), ("arm",)))
    bench.run(0.5)
    bench.command(JointTrajectory((), ()))
    bench.run(0.01)
    assert bench.held == {"spin": pytest.approx(0.5), "arm": pytest.approx(0.25)}
    bench.run(1.0)
    assert bench.positions["arm"] == pytest.approx(0.25)


def test_trajectory_waits_for_its_stamp(bench: Bench) -> None:
    bench.command(trajectory(TrajectoryPoint(S, (0.4,)), start_ns=2 * S))
    bench.run(2.0)
    assert bench.positions["arm"] == 0.0
    bench.run(0.5)
    assert bench.positions["arm"] == pytest.approx(0.2)


def test_points_in_the_past_are_left_out(bench: Bench) -> None:
    bench.now_ns = 10 * S
    bench.command(trajectory(TrajectoryPoint(S, (1.9,)), TrajectoryPoint(4 * S, (0.4,)), start_ns=8 * S))
    bench.run(1.0)
    assert bench.positions["arm"] == pytest.approx(0.2)


def test_single_point_at_time_zero_is_a_position(bench: Bench) -> None:
    bench.command(trajectory(TrajectoryPoint(0, (0.5,))))
    bench.run(0.5)
    assert bench.positions["arm"] == pytest.approx(0.25)


def test_first_point_at_time_zero_gives_the_acceleration_to_start_with(bench: Bench) -> None:
    bench.command(trajectory(TrajectoryPoint(0, (0.0,), (0.0,), (0.4,)), TrajectoryPoint(2 * S, (0.4,), (0.0,), (0.0,))))
    bench.run(0.1)
    # 0.2 t^2 + 0.2 t^3 - 0.225 t^4 + 0.05 t^5 has these values, speeds and accelerations at t = 0 and 2.
    assert bench.positions["arm"] == pytest.approx(0.002 + 0.0002 - 0.0000225 + 0.0000005, abs=1e-9)


@pytest.mark.parametrize(
    ("command", "words"),
    [
        (JointPositions((2.5,), ("arm",)), "joint 'arm': position is 2.5, must be -1 to 2"),
        (JointVelocities((-0.6,), ("arm",)), "joint 'arm': velocity is -0.6, must be -0.5 to 0.5"),
        (JointPositions((0.1,), ("elbow",)), "no joint 'elbow' that accepts commands; known: arm, lift, spin"),
        (JointPositions((0.1,), ("wheel",)), "'wheel' belongs to the drive; send a velocity"),
        (JointPositions((0.1, 0.2)), "has 2 positions, the robot has 3 joints that accept commands: arm, lift, spin"),
        (
            trajectory(TrajectoryPoint(9 * S, (0.1,)), TrajectoryPoint(19 * S, (2.1,))),
            "position of point 1 is 2.1, must be -1 to 2",
        ),
        (trajectory(TrajectoryPoint(9 * S, (0.1,), (0.7,))), "velocity of point 0 is 0.7, must be -0.5 to 0.5"),
        (trajectory(TrajectoryPoint(S, (1.0,))), "'arm' would go from 0 to 1 at 1 a second, its limit is 0.5; give it more time"),
        (trajectory(TrajectoryPoint(9 * S, (0.1,)), names=("wheel",)), "belongs to the drive"),
        (trajectory(TrajectoryPoint(S, (0.1,)), start_ns=2 * S), "ended at 3 s, now it is 5 s"),
    ],
)
def test_impossible_command_is_refused_in_one_line_and_changes_nothing(bench: Bench, command: JointCommand, words: str) -> None:
    bench.now_ns = 5 * S
    bench.command(JointVelocities((1.0,), ("spin",)))
    with pytest.raises(CommandError) as error:
        bench.command(command)
    assert words in str(error.value)
    assert "\n" not in str(error.value)
    assert bench.control.active == ("spin",)


def test_position_at_the_limit_is_allowed_whatever_the_planner_rounds(bench: Bench) -> None:
    bench.command(JointPositions((2.0 + 1e-9,), ("arm",)))
    bench.command(trajectory(TrajectoryPoint(4 * S, (2.0,), (0.5,))))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: JointPositions((math.nan,), ("arm",)), "joint 'arm' is nan, must be finite"),
        (lambda: JointVelocities((0.0, math.inf)), "number 1 is inf"),
        (lambda: JointPositions(()), "there are none"),
        (lambda: JointPositions((0.0,), ("a", "b")), "1 numbers for 2 joints"),
        (lambda: JointPositions((0.0, 1.0), ("a", "a")), "'a' is named twice"),
        (lambda: JointTrajectory(("a", "a"), (TrajectoryPoint(0, (0.0, 0.0)),)), "'a' is named twice"),
        (lambda: JointTrajectory((), (TrajectoryPoint(0, (0.0,)),)), "no joint names"),
        (lambda: trajectory(TrajectoryPoint(0, ())), "point 0 has 0 positions for 1 joints"),
        (lambda: trajectory(TrajectoryPoint(0, (0.0,), (1.0, 2.0))), "point 0 has 2 velocities for 1 joints"),
        (lambda: trajectory(TrajectoryPoint(0, (0.0,), (), (1.0,))), "accelerations but no velocities"),
        (
            lambda: trajectory(TrajectoryPoint(0, (0.0,)), TrajectoryPoint(S, (math.nan,))),
            "point 1: positions: that of joint 'arm'",
        ),
        (lambda: trajectory(TrajectoryPoint(-1, (0.0,))), "must not be negative"),
        (
            lambda: trajectory(TrajectoryPoint(S, (0.0,)), TrajectoryPoint(S, (0.1,))),
            "point 1: time_from_start is 1 s, must be after that of point 0, 1 s",
        ),
    ],
)
def test_invalid_command_is_refused(make: Callable[[], JointCommand], words: str) -> None:
    with pytest.raises(CommandError) as error:
        make()
    assert words in str(error.value)
