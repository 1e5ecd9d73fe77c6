"""Reports a ``RobotTrial`` as lines of text: rest, stability, test drive, footprint, topics, and values to set by hand."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

import numpy as np

from gibson_sim.description.urdf import read_urdf
from gibson_sim.quoting import clipped
from gibson_sim.robots.drive_spec import AckermannSpec
from gibson_sim.robots.drives import make_drive
from gibson_sim.robots.loading.guess import Guess
from gibson_sim.robots.spec import RobotSpec
from gibson_sim_tools.robots.trial import DriveTest, RobotTrial

_SAFETY_FACTOR = 0.8
"""Fraction of the tipping acceleration proposed as a limit."""
_LEVEL = math.radians(0.3)
"""Pitch or roll below which a robot stands level, radians."""
_OFF_CENTRE = 0.1
"""Lateral offset of the centre of mass from the middle, as a fraction of the support polygon's width, above which it is reported."""
_SLIP, _TURN_ERROR = 0.02, math.radians(5.0)
"""Slip, and error of a turn (radians), above which they are reported."""
_DRIFT = 0.005
"""Drift of a robot at rest above which it is reported, m."""
_MIN_ACCELERATION = 0.1
"""Minimum acceleration proposed as a limit, m/s^2."""
_TWO_WHEELS = 2
_ASSUMED_MASS = " has no mass; "
"""Part of the physics engine's warning about an assumed mass."""
_MISPLACED = "it falls over: its centre of mass is not above its wheels and casters"
_LONGEST_NAME = 60
"""Maximum length of a link's name in the report, characters."""
_SUSPENSION = re.compile(r"suspension|wheel|caster|bumper|rocker|bogie", re.IGNORECASE)
"""Names of joints with motors that no task moves."""
_MAX_NAMED = 4
"""Maximum number of items listed; the rest are counted."""


def report_lines(trial: RobotTrial, guesses: Sequence[Guess] = ()) -> list[str]:
    """Returns the report: measured values, footprint and topics, then values to set by hand, one line each.

    Args:
        trial: The measurements.
        guesses: Guesses behind the robot's file; they name what the description lacks.
    """
    robot = trial.robot
    lines = [*_assumed_masses(trial), *_standing(trial), *(_drive_line(drive) for drive in trial.drives)]
    if robot.drive is None:
        lines.append("drive: none; the test drive is left out")
    elif trial.lacks_support:
        lines.append("drive: it cannot stand; the test drive is left out")
    elif trial.has_fallen:
        lines.append("drive: it has fallen over at rest; the test drive is left out")
    corners = ", ".join(f"[{x:.3f}, {y:.3f}]" for x, y in trial.footprint.tolist())
    lines.append(f'footprint: "[{corners}]"; robot_radius: {robot.radius:.3f} (Nav2, metres)')
    lines += [f"topic: {topic}" for topic in topics(robot)]
    hand = by_hand(trial, guesses)
    return [*lines, *(f"set by hand: {line}" for line in hand)]


def _assumed_masses(trial: RobotTrial) -> list[str]:
    """Returns the line about masses missing in the description; the other figures depend on them."""
    assumed = trial.stability.assumed
    if not assumed:
        return []
    named = ", ".join(f"{clipped(name, _LONGEST_NAME)} ({kg:g} kg)" for name, kg in assumed[:_MAX_NAMED])
    more = f" and {len(assumed) - _MAX_NAMED} more" if len(assumed) > _MAX_NAMED else ""
    return [f"masses are missing: the figures below assume {named}{more}; give these links an <inertial>"]


def _standing(trial: RobotTrial) -> list[str]:
    """Returns the lines about the robot at rest."""
    stability, (x, y, z) = trial.stability, trial.stability.center_of_mass.tolist()
    lean = ""
    if abs(trial.pitch) > _LEVEL:
        lean += f", nose {'down' if trial.pitch > 0 else 'up'}"
    if abs(trial.roll) > _LEVEL:
        lean += f", {'right' if trial.roll > 0 else 'left'} side down"
    lines = []
    if not trial.lacks_support:  # else its pose on the floor is arbitrary
        lines.append(
            f"at rest: tilt {math.degrees(trial.tilt):.2f} degrees{lean}; moved {trial.drift * 1000:.1f} mm by itself in 2 s"
        )
    lines.append(f"mass: {stability.mass:.4g} kg, centre of mass at x {x:.3f}, y {y:.3f} m, {z:.3f} m above the floor")
    if trial.robot.fixed_base:
        lines.append("support: its base is fixed, it cannot tip over")
        return lines
    if trial.lacks_support:
        two = len(list(_driven(trial.robot))) == _TWO_WHEELS
        lines.append(
            f'support: it stands on {"two wheels" if two else "a line"}: add a caster, such as a ball with <lateral_friction value="0"/>'
        )
        return lines
    corners = ", ".join(f"({x:.3f}, {y:.3f})" for x, y in stability.support.tolist())
    if len(stability.support) < 3:
        lines.append(f"support: stands on {corners or 'nothing'}, which is not an area")
        return lines
    if stability.margin <= 0.0 or z <= 0.0:
        lines.append(f"support polygon: {corners} m; {_MISPLACED}")
        return lines
    slope = math.degrees(stability.tilt_margin)
    lines.append(f"support polygon: {corners} m")
    lines.append(
        f"static stability margin: {stability.margin * 1000:.0f} mm; tips over on a slope of {slope:.1f} degrees in the worst direction"
    )
    start, brake, left, right = (stability.tipping_acceleration(d) for d in ((1.0, 0.0), (-1.0, 0.0), (0.0, 1.0), (0.0, -1.0)))
    lines.append(
        f"tips over at: starting {start:.2f}, braking {brake:.2f}, sideways {min(left, right):.2f} m/s^2{_limits(trial.robot)}"
    )
    return lines


def _limits(robot: RobotSpec) -> str:
    """Returns the largest accelerations that the drive allows, as part of a line."""
    drive = robot.drive
    if drive is None:
        return ""
    sideways = drive.max_linear * (
        drive.max_linear * drive.max_curvature if isinstance(drive, AckermannSpec) else drive.max_angular
    )
    return f" (its limits: {drive.max_linear_acceleration:.2f} forward, {sideways:.2f} sideways at full speed and turn)"


def _drive_line(drive: DriveTest) -> str:
    """Returns the line about the errors of one motion of the test drive."""
    x, y, yaw = drive.driven
    tilt = f"tilt up to {math.degrees(drive.tilt):.2f} degrees"
    if drive.turns:
        turned, moved = math.degrees(yaw), math.hypot(x, y) * 1000
        error = turned - math.degrees(drive.commanded.yaw)
        return f"{drive.name}: {turned:.2f} degrees ({round(error, 2) + 0.0:+.2f}), {moved:.1f} mm off its place; slip {_percent(drive.slip)}; {tilt}"
    forward = np.array(drive.commanded[:2]) / np.hypot(*drive.commanded[:2])
    distance, lateral = float(forward @ (x, y)), float(forward[0] * y - forward[1] * x)
    error = distance - math.hypot(*drive.commanded[:2])
    drift = f"{abs(lateral) * 1000:.1f} mm to the {'left' if lateral >= 0 else 'right'}"
    heading = f"heading {round(math.degrees(yaw), 2) + 0.0:+.2f} degrees"
    return f"{drive.name}: {distance:.4f} m ({round(error * 1000, 1) + 0.0:+.1f} mm), {drift}, {heading}; slip {_percent(drive.slip)}; {tilt}"


def _percent(part: float) -> str:
    """Returns a fraction in percent, without a negative zero."""
    return f"{round(100 * part, 2) + 0.0:.2f} %"


def topics(robot: RobotSpec) -> tuple[str, ...]:
    """Returns the topics of a robot, each with its type, and ``in`` if the simulation subscribes to it."""
    names = []
    if robot.drive is not None:
        names.append("cmd_vel (in; geometry_msgs/Twist or TwistStamped)")
    names += [
        "odom, ground_truth/odom (nav_msgs/Odometry)",
        "joint_states (sensor_msgs/JointState)",
        "/tf, /tf_static, robot_description",
    ]
    model = read_urdf(robot.urdf)
    if any(joint.has_motor for joint in model.joints if joint.name not in _driven(robot)):
        names.append("joint_trajectory (in; trajectory_msgs/JointTrajectory), joint_command (in; sensor_msgs/JointState)")
    sensors = robot.sensors
    names += [f"{lidar.name} (sensor_msgs/LaserScan, {lidar.rate_hz:g} Hz)" for lidar in sensors.lidars]
    names += [f"{lidar.name} (sensor_msgs/PointCloud2, {lidar.rate_hz:g} Hz)" for lidar in sensors.lidars_3d]
    names += [f"{imu.name} (sensor_msgs/Imu, {imu.rate_hz:g} Hz)" for imu in sensors.imus]
    names += [f"{bumper.name} (std_msgs/Bool, {bumper.rate_hz:g} Hz), {bumper.name}/wrench" for bumper in sensors.bumpers]
    names += [f"{sensors.battery.name} (sensor_msgs/BatteryState)"] if sensors.battery is not None else []
    for camera in robot.cameras:
        images = [f"{camera.name}/{'' if output == 'rgb' else output + '/'}image_raw" for output in camera.outputs]
        names.append(
            f"{', '.join(images)} (sensor_msgs/Image, {camera.rate_hz:g} Hz, {camera.width} x {camera.height}), with camera_info"
        )
    return tuple(names)


def _driven(robot: RobotSpec) -> Iterable[str]:
    """Returns the names of the drive's joints."""
    if robot.drive is None:
        return ()
    drive = make_drive(robot.drive)
    return {joint.name for joint in (*drive.wheels, *drive.steering)}


def by_hand(trial: RobotTrial, guesses: Sequence[Guess] = ()) -> tuple[str, ...]:
    """Returns the values to set in the file or to correct in the description, one line each."""
    robot = trial.robot
    lines = [guess.by_hand for guess in guesses if guess.by_hand]
    if robot.drive is not None and guesses:
        limits = "max_linear, max_angular, their accelerations and max_wheel_torque"
        lines.append(
            f"drive: {limits}, from its data sheet; now {robot.drive.max_linear:g} m/s and {robot.drive.max_angular:g} rad/s, the defaults"
        )
    if guesses and robot.drive is not None and not (robot.cameras or robot.sensors.lidars or robot.sensors.lidars_3d):
        lines.append("cameras, lidar: none was found in the description; add those of the robot, on its links")
    warnings = [line for line in trial.warnings if _ASSUMED_MASS not in line]  # they are in the first line of the report
    lines += [*_stability_by_hand(trial), *_drive_by_hand(trial), *_joints_by_hand(robot), *_warnings_by_hand(warnings)]
    return tuple(lines)


def _stability_by_hand(trial: RobotTrial) -> list[str]:
    robot, stability = trial.robot, trial.stability
    lines: list[str] = []
    if robot.fixed_base or len(stability.support) < 3 or trial.lacks_support:
        return lines
    if stability.margin <= 0.0 or stability.center_of_mass[2] <= 0.0:
        lines.append(f"{_MISPLACED}; correct masses and origins in the description")
    elif robot.drive is not None:
        tipping = min(stability.tipping_acceleration((1.0, 0.0)), stability.tipping_acceleration((-1.0, 0.0)))
        if tipping < _MIN_ACCELERATION:
            lines.append(
                "it nearly tips over at rest: its centre of mass is above an edge of its support; correct masses and origins, or move a caster"
            )
        elif tipping < robot.drive.max_linear_acceleration:
            lines.append(
                f"drive.max_linear_acceleration: {_SAFETY_FACTOR * tipping:.2g} instead of {robot.drive.max_linear_acceleration:g} m/s^2, at which "
                "it tips; or correct the masses in the description"
            )
    sides = stability.support[:, 1].min(), stability.support[:, 1].max()
    offset = float(stability.center_of_mass[1]) - (sides[0] + sides[1]) / 2
    if abs(offset) > _OFF_CENTRE * (sides[1] - sides[0]):
        side = "left" if offset > 0 else "right"
        lines.append(
            f"masses: the centre of mass is {abs(offset) * 1000:.0f} mm to the {side} of the middle; compare it with the robot"
        )
    if trial.drift > _DRIFT:
        lines.append(f"it moves {trial.drift * 1000:.0f} mm by itself; check the heights of wheels and casters (wheel_drop)")
    return lines


def _drive_by_hand(trial: RobotTrial) -> list[str]:
    lines = []
    for drive in trial.drives:
        if abs(drive.slip) > _SLIP:
            lines.append(
                f"{drive.name}: its wheels slip by {100 * drive.slip:.1f} %; check friction, wheel_radius, wheel_drop and other floor contacts"
            )
        elif drive.turns and abs(drive.driven.yaw - drive.commanded.yaw) > _TURN_ERROR:
            lines.append(
                f"{drive.name}: it turns {math.degrees(drive.driven.yaw):.0f} degrees; check max_wheel_torque and masses"
            )
    return lines


def _joints_by_hand(robot: RobotSpec) -> list[str]:
    driven = _driven(robot)
    joints = [joint for joint in read_urdf(robot.urdf).joints if joint.has_motor and joint.name not in driven]
    if not joints or robot.manipulators:
        return []
    joints = [joint for joint in joints if not _SUSPENSION.search(joint.name)]
    if not joints:
        return []
    names = ", ".join(joint.name for joint in joints[:_MAX_NAMED]) + (", ..." if len(joints) > _MAX_NAMED else "")
    return [
        f"manipulators, named_poses and home: its {len(joints)} other joints ({names}) stand at 0 or at their nearest limit, in which it has a "
        f"radius of {robot.radius:.2f} m"
    ]


def _warnings_by_hand(warnings: Sequence[str]) -> list[str]:
    more = len(warnings) - _MAX_NAMED
    return [f"description: {line}" for line in warnings[:_MAX_NAMED]] + (
        [f"description: {more} more such lines"] if more > 0 else []
    )
