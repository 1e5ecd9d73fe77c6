"""Renders a single robot in one of its poses."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from gibson_sim.description.shapes import Shape, VisualSpec
from gibson_sim.geometry.transforms import quat_from_matrix
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.spec import LightSpec, SceneSpec
from gibson_sim.simulation import Simulation
from gibson_sim.types import CameraSpec, Pose

Rgb = NDArray[np.uint8]
_FOV = math.radians(24.0)
_MARGIN = 1.06
"""Camera distance, relative to that at which the robot just fills the picture."""
_ARROW = (1.05, 1.75)
"""Start and end of the arrow on the floor, distances from the robot's centre in radii of the robot."""
_SETTLING_STEPS = 24
"""Physics steps until the wheels rest on the floor."""
_FLOOR_M = 60.0
"""Edge of the floor, m."""
_FLOOR_COLOR = (0.25, 0.37, 0.47, 1.0)
"""Dark blue, in contrast to robots that are grey, white, black or of bright colours."""
_ARROW_COLOR = (1.0, 0.45, 0.05, 1.0)


def robot_picture(robot: RobotSpec, pose: str = "", *, width: int = 640, height: int = 640, yaw_deg: float = -35.0) -> Rgb:
    """Renders a robot on a floor with an arrow that points ahead of it; returns (height, width, 3) uint8 sRGB.

    Args:
        robot: the robot.
        pose: named pose; "" = initial pose.
        width: width of the picture, pixels.
        height: height of the picture, pixels.
        yaw_deg: azimuth of the camera: 0 = straight ahead of the robot, counter-clockwise seen from above.

    Raises:
        RobotError: the pose is unknown.
    """
    if pose:
        robot = replace(robot, joints=tuple({**dict(robot.joints), **dict(robot.named_pose(pose).joints)}.items()))
    floor = VisualSpec("floor", "", Shape("box", (_FLOOR_M, _FLOOR_M, 0.02)), Pose((0.0, 0.0, -0.0102)), _FLOOR_COLOR)
    light = LightSpec(sun_direction=(-0.45, 0.35, -1.0), sun=0.75, ambient=0.42, background=(0.86, 0.87, 0.88), shadows=True)
    root = robot.urdf.parent
    scene = SceneSpec(
        "robot", root, "", (floor, *_arrow(robot.radius)), (), ground_z=0.0, light=light, robots=(replace(robot, start=Pose()),)
    )
    with Simulation(scene, None) as sim:
        sim.step(steps=_SETTLING_STEPS)
        low, high = sim.world.bounds(robot.name)
        high[0] = max(high[0], _ARROW[1] * robot.radius)
        frame = sim.render(_camera(low, high, width, height, math.radians(yaw_deg)))
    assert frame.rgb is not None
    return frame.rgb


def _arrow(radius: float) -> list[VisualSpec]:
    """Returns an arrow on the floor along x, ahead of a robot. ``radius``: radius of the robot, m."""
    start, end, width, thickness = *(part * radius for part in (*_ARROW, 0.13)), 0.004
    head = 0.3 * radius
    middle = Pose(((start + end - width / 2) / 2, 0.0, 0.0))
    parts = [VisualSpec("arrow", "", Shape("box", (end - start - width / 2, width, thickness)), middle, _ARROW_COLOR)]
    for side in (1.0, -1.0):  # each bar of the head runs from the tip backwards at 45 degrees
        bar_offset = head / 2 * math.sqrt(0.5)
        quat_xyzw = (0.0, 0.0, math.sin(side * -math.pi / 8), math.cos(math.pi / 8))
        bar_pose = Pose((end - width / 2 - bar_offset + width / 4, side * (bar_offset - width / 4), thickness / 4), quat_xyzw)
        parts.append(VisualSpec(f"arrow head {side:g}", "", Shape("box", (head, width, thickness)), bar_pose, _ARROW_COLOR))
    return parts


def _camera(low: NDArray[np.float64], high: NDArray[np.float64], width: int, height: int, yaw: float) -> CameraSpec:
    """Returns a camera that frames a bounding box (corners in m) from slightly above. ``yaw``: azimuth, radians."""
    middle = (low + high) / 2
    pitch = math.radians(16.0)
    forward = -np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch)])
    right = np.cross(forward, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(forward, right)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]) - middle
    half = math.tan(_FOV / 2)
    distances = [max(abs(float(c @ right)) * height / width, abs(float(c @ down))) / half - float(c @ forward) for c in corners]
    position = middle - forward * max(distances) * _MARGIN
    x, y, z = position.tolist()
    return CameraSpec(
        "eye", "", Pose((x, y, z), quat_from_matrix(np.stack([right, down, forward], axis=1))), width, height, _FOV,
        outputs=("rgb",), samples=4,
    )  # fmt: skip
