"""What scripts do with things on furniture: go before it, ready the arm, take from above. Pure."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.tasks.episode import Action, Item, View, item_root
from gibson_sim.tasks.furnishing import Furniture, extent, height, middle
from gibson_sim.tasks.ground import Ground
from gibson_sim.tasks.scripts.arm import Arm, Steps, creep, drive, face, pointing, wait
from gibson_sim.tasks.scripts.driving import Driver
from gibson_sim.types import Vec3

F64 = NDArray[np.float64]
ABOVE = 0.12
"""Metres above a thing from which a hand comes down to it."""
FINGERS = 0.035
"""Metres that the fingers reach over a thing: the palm stays above it."""
CLOSES_S = 1.2
"""Seconds in which a hand closes."""
READY = 0.46
"""Metres from the base to the hand that is ready."""
_ROUND = 0.01
"""Metres by which a thing is wider one way than the other at least, for it to matter how it is taken."""
_NEAR = 0.06
"""Metres from the place before furniture at which nobody drives there."""


def go_before(view: View, ground: Ground, one: Furniture, every: Sequence[Furniture], grasp: bool | None = None) -> Steps:
    """Drives to where one reaches for furniture, round all furniture, and faces it."""
    if view.distance_to(one.stand) > _NEAR:
        driver = Driver(ground, one.stand, obstacles=[other.outline() for other in every], max_linear=0.4)
        view = yield from drive(view, driver, grasp=grasp)
    return (yield from face(view, one.yaw, 0.01))


def ready(
    view: View, arm: Arm, z: float, rotation: F64, grasp: bool | None = None, *, low: float | None = None, left: float = 0.0
) -> Steps:
    """Holds the hand before the robot.

    Args:
        view: what is known now.
        arm: whose hand.
        z: height of the hand, world metres.
        rotation: its axes, (3, 3).
        grasp: what the hand does.
        low: height, world metres, that the hand has to reach from there: what bears the arm is lifted for it; None = for ``z``.
        left: metres to the left of the base.
    """
    c, s = math.cos(view.yaw), math.sin(view.yaw)
    bearing = arm.lifted(z if low is None else low)
    begin = {name: position for name, position in arm.named("ready").items() if name in arm.joints}
    joints = arm.reaching(
        view, (view.xy[0] + READY * c - left * s, view.xy[1] + READY * s + left * c, z), rotation, begin={**begin, **bearing}
    )
    if joints is None:
        return view
    # What turns the whole arm comes last: till then it stays folded beside the robot.
    first = {name: position for name, position in joints.items() if name != arm.joints[0]}
    view = yield from arm.move(view, {**bearing, **first}, grasp)
    return (yield from arm.move(view, {**bearing, **joints}, grasp, tolerance=0.02))


def come_near(view: View, one: Furniture, gap: float, grasp: bool | None = None, beyond: float = 0.0) -> Steps:
    """Drives straight on until the base is ``gap`` metres from the front edge of furniture, or of what stands out ``beyond`` it."""
    _, high = extent(one.item.model)
    ahead, _ = view.in_base(one.point(high[0] + beyond, 0.0, 0.0))
    return (yield from creep(view, ahead - gap, grasp=grasp))


def downwards(view: View, item: Item | None = None) -> F64:
    """Returns the axes of a hand that points down, (3, 3): its fingers beside the robot, or, of a thing, where that is narrow."""
    across = view.yaw + math.pi / 2.0
    if item is not None:
        low, high = extent(item.model)
        deep, wide = high[0] - low[0], high[1] - low[1]
        if abs(deep - wide) > _ROUND:
            narrow = yaw_from_quat(view.links[item_root(item)].quat_xyzw) + (0.0 if deep < wide else math.pi / 2.0)
            across += math.remainder(narrow - across, math.pi)
    return pointing((0.0, 0.0, -1.0), (math.cos(across), math.sin(across), 0.0))


def grip(item: Item, view: View) -> Vec3:
    """Returns where a hand that comes from above takes a thing, world metres."""
    x, y, z = middle(item, view)
    half = height(item.model) / 2.0
    return x, y, max(z + half - FINGERS, z - half + FINGERS)


def take_from_above(view: View, arm: Arm, item: Item, lift: float) -> Steps:
    """Takes a thing and lifts it by ``lift`` metres; a hand that got hold of something else lets go of that and comes up empty."""
    rotation = downwards(view, item)
    x, y, z = grip(item, view)
    above = arm.reaching(view, (x, y, z + ABOVE), rotation)
    if above is not None:
        view = yield from arm.move(view, above, False, tolerance=0.01)
    view = yield from arm.straight(view, grip(item, view), rotation, False)
    view = yield from wait(view, CLOSES_S, Action(grasp=True))
    right = view.held in ("", item.name)
    if not right:
        view = yield from wait(view, CLOSES_S, Action(grasp=False))
    # What bears the arm lifts straight up; the arm does the rest.
    z = arm.tool(view).position[2] + lift
    view = yield from arm.move(view, arm.rise(view, lift), right, tolerance=0.01)
    x, y, now = arm.tool(view).position
    return (yield from arm.straight(view, (x, y, max(z, now)), rotation, right))
