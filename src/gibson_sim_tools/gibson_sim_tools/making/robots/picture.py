"""Renders a robot alone, in one of its poses."""

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
"""Factor of the distance at which the robot just fills the picture."""
_ARROW = (1.05, 1.75)
"""Begin and end of the arrow on the floor, in radii of the robot, from its centre."""
_SETTLING = 24
"""Steps until the wheels rest on the floor."""
_FLOOR_M = 60.0
_FLOOR_COLOR = (0.25, 0.37, 0.47, 1.0)
"""A dark blue: robots are grey, white, black or in bright colours."""
_ARROW_COLOR = (1.0, 0.45, 0.05, 1.0)


def robot_picture(robot: RobotSpec, pose: str = "", *, width: int = 640, height: int = 640, yaw_deg: float = -35.0) -> Rgb:
    """Returns a picture of a robot on a floor with an arrow that points ahead of it, (height, width, 3) uint8 sRGB.

    Args:
        robot: the robot.
        pose: a named pose; "" = initial pose.
        width: pixels.
        height: pixels.
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
        sim.step(steps=_SETTLING)
        low, high = sim.world.bounds(robot.name)
        high[0] = max(high[0], _ARROW[1] * robot.radius)
        frame = sim.render(_camera(low, high, width, height, math.radians(yaw_deg)))
    assert frame.rgb is not None
    return frame.rgb


def _arrow(radius: float) -> list[VisualSpec]:
    """Returns an arrow on the floor along x, ahead of a robot of a radius, metres."""
    begin, end, width, thin = *(part * radius for part in (*_ARROW, 0.13)), 0.004
    head = 0.3 * radius
    middle = Pose(((begin + end - width / 2) / 2, 0.0, 0.0))
    parts = [VisualSpec("arrow", "", Shape("box", (end - begin - width / 2, width, thin)), middle, _ARROW_COLOR)]
    for side in (1.0, -1.0):  # a bar of the head begins at the tip, and runs back at 45 degrees
        back = head / 2 * math.sqrt(0.5)
        turned = (0.0, 0.0, math.sin(side * -math.pi / 8), math.cos(math.pi / 8))
        place = Pose((end - width / 2 - back + width / 4, side * (back - width / 4), thin / 4), turned)
        parts.append(VisualSpec(f"arrow head {side:g}", "", Shape("box", (head, width, thin)), place, _ARROW_COLOR))
    return parts


def _camera(low: NDArray[np.float64], high: NDArray[np.float64], width: int, height: int, yaw: float) -> CameraSpec:
    """Returns a camera that frames a box, corners in metres, from slightly above."""
    middle = (low + high) / 2
    pitch = math.radians(16.0)
    ahead = -np.array([math.cos(yaw) * math.cos(pitch), math.sin(yaw) * math.cos(pitch), math.sin(pitch)])
    right = np.cross(ahead, [0.0, 0.0, 1.0])
    right /= np.linalg.norm(right)
    down = np.cross(ahead, right)
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]) - middle
    half = math.tan(_FOV / 2)
    away = [max(abs(float(c @ right)) * height / width, abs(float(c @ down))) / half - float(c @ ahead) for c in corners]
    position = middle - ahead * max(away) * _MARGIN
    x, y, z = position.tolist()
    return CameraSpec(
        "eye", "", Pose((x, y, z), quat_from_matrix(np.stack([right, down, ahead], axis=1))), width, height, _FOV,
        outputs=("rgb",), samples=4,
    )  # fmt: skip
