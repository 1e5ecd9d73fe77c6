"""Script steps for handling objects on furniture: drive to its stand, prepare the arm, grasp from above. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.tasks.episode import Action, Item, Observation, item_root
from gibson_sim.tasks.furnishing import Furniture, extent, height, item_centre
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.scripts.arm import Arm, Steps, creep, drive, face, pointing, wait
from gibson_sim.tasks.scripts.driving import Driver
from gibson_sim.types import Vec3

F64 = NDArray[np.float64]
ABOVE = 0.12
"""Height above an object at which the gripper begins to descend, metres."""
FINGERS = 0.035
"""Overlap of the fingers with an object, metres: the palm remains above it."""
CLOSES_S = 1.2
"""Time in which the gripper closes or opens, seconds."""
READY = 0.46
"""Distance from the base to the gripper in the ready posture, metres."""
_ROUND = 0.01
"""Minimum difference of width and depth for grasping an object across its narrow side, metres."""
_NEAR = 0.06
"""Distance to the stand within which the robot does not drive to it, metres."""


def drive_to_stand(
    obs: Observation, ground: Ground, furniture: Furniture, obstacles: Sequence[Furniture], grasp: bool | None = None
) -> Steps:
    """Drives to the stand of furniture, around ``obstacles``, and faces the furniture."""
    if obs.distance_to(furniture.stand) > _NEAR:
        driver = Driver(ground, furniture.stand, obstacles=[other.outline() for other in obstacles], max_linear=0.4)
        obs = yield from drive(obs, driver, grasp=grasp)
    return (yield from face(obs, furniture.yaw, 0.01))


def ready(
    obs: Observation, arm: Arm, z: float, rotation: F64, grasp: bool | None = None, *, low: float | None = None, left: float = 0.0
) -> Steps:
    """Moves the gripper to the ready posture in front of the robot.

    Args:
        obs: the current observation.
        arm: the arm.
        z: height of the gripper, world frame, metres.
        rotation: axes of the tool, (3, 3).
        grasp: command to the gripper.
        low: lowest height that the gripper must reach later, world frame, metres, for which the torso is lifted; None = ``z``.
        left: offset to the left of the base, metres.
    """
    c, s = math.cos(obs.yaw), math.sin(obs.yaw)
    torso = arm.lifted(z if low is None else low)
    begin = {name: position for name, position in arm.named("ready").items() if name in arm.joints}
    joints = arm.reaching(
        obs, (obs.xy[0] + READY * c - left * s, obs.xy[1] + READY * s + left * c, z), rotation, begin={**begin, **torso}
    )
    if joints is None:
        return obs
    # The joint that rotates the whole arm moves last: until then the arm remains folded beside the robot.
    first = {name: position for name, position in joints.items() if name != arm.joints[0]}
    obs = yield from arm.move(obs, {**torso, **first}, grasp)
    return (yield from arm.move(obs, {**torso, **joints}, grasp, tolerance=0.02))


def approach(obs: Observation, furniture: Furniture, gap: float, grasp: bool | None = None, beyond: float = 0.0) -> Steps:
    """Drives straight ahead until the base is ``gap`` metres from the front edge of furniture, or from ``beyond`` metres in front of it."""
    _, high = extent(furniture.item.model)
    ahead, _ = obs.in_base(furniture.point(high[0] + beyond, 0.0, 0.0))
    return (yield from creep(obs, ahead - gap, grasp=grasp))


def downwards(obs: Observation, item: Item | None = None) -> F64:
    """Returns the axes of a downward tool, (3, 3): fingers on the left and right of the robot, or at the narrow sides of an item."""
    across = obs.yaw + math.pi / 2.0
    if item is not None:
        low, high = extent(item.model)
        deep, wide = high[0] - low[0], high[1] - low[1]
        if abs(deep - wide) > _ROUND:
            narrow = yaw_from_quat(obs.links[item_root(item)].quat_xyzw) + (0.0 if deep < wide else math.pi / 2.0)
            across += math.remainder(narrow - across, math.pi)
    return pointing((0.0, 0.0, -1.0), (math.cos(across), math.sin(across), 0.0))


def grip(item: Item, obs: Observation) -> Vec3:
    """Returns the tool position for grasping an item from above, world frame, metres."""
    x, y, z = item_centre(item, obs)
    half = height(item.model) / 2.0
    return x, y, max(z + half - FINGERS, z - half + FINGERS)


def take_from_above(obs: Observation, arm: Arm, item: Item, lift: float) -> Steps:
    """Grasps an item from above and lifts it by ``lift`` metres; a gripper that has grasped another body releases it and lifts empty."""
    rotation = downwards(obs, item)
    x, y, z = grip(item, obs)
    above = arm.reaching(obs, (x, y, z + ABOVE), rotation)
    if above is not None:
        obs = yield from arm.move(obs, above, False, tolerance=0.01)
    obs = yield from arm.straight(obs, grip(item, obs), rotation, False)
    obs = yield from wait(obs, CLOSES_S, Action(grasp=True))
    keep = obs.held in ("", item.name)
    if not keep:
        obs = yield from wait(obs, CLOSES_S, Action(grasp=False))
    # The torso lifts straight up; the arm lifts the remaining distance.
    z = arm.tool(obs).position[2] + lift
    obs = yield from arm.move(obs, arm.rise(obs, lift), keep, tolerance=0.01)
    x, y, tool_z = arm.tool(obs).position
    return (yield from arm.straight(obs, (x, y, max(z, tool_z)), rotation, keep))
