"""Sizes of movable bodies and geometry of door leaves: the properties of ``scenes/objects`` that plans use."""

from __future__ import annotations

import math

from gibson_sim.types import Vec3
from gibson_sim_tools.making.building import Body, Opening, Point, Wall
from gibson_sim_tools.making.planning.rectangles import Box, Rect, bounding_rect, rotated_bounds

SIZES: dict[str, Vec3] = {
    "bottle_water": (0.066, 0.066, 0.235),
    "bottle_wine": (0.076, 0.076, 0.31),
    "can_soda": (0.066, 0.066, 0.116),
    "can_food": (0.075, 0.075, 0.11),
    "cup": (0.08, 0.136, 0.062),
    "mug": (0.082, 0.162, 0.096),
    "bowl": (0.16, 0.16, 0.068),
    "plate": (0.26, 0.26, 0.024),
    "glass_tumbler": (0.074, 0.074, 0.12),
    "book_a": (0.155, 0.225, 0.03),
    "book_b": (0.13, 0.195, 0.022),
    "book_stack": (0.175, 0.245, 0.098),
    "box_cereal": (0.07, 0.19, 0.29),
    "box_small": (0.12, 0.18, 0.09),
    "box_cardboard": (0.3, 0.4, 0.28),
    "vase": (0.14, 0.14, 0.28),
    "candle": (0.07, 0.07, 0.1),
    "teapot": (0.15, 0.25, 0.15),
    "laptop": (0.39, 0.33, 0.215),
    "keyboard": (0.14, 0.44, 0.028),
    "remote_control": (0.17, 0.046, 0.022),
    "fruit_apple": (0.075, 0.075, 0.075),
    "fruit_orange": (0.076, 0.076, 0.076),
    "toy_ball": (0.12, 0.12, 0.12),
    "ball": (0.22, 0.22, 0.22),
    "pen_cup": (0.085, 0.085, 0.19),
    "clock": (0.05, 0.14, 0.145),
    "bin_waste": (0.28, 0.28, 0.33),
    "basket": (0.3, 0.4, 0.23),
    "chair_wooden": (0.5, 0.44, 0.88),
    "stool": (0.36, 0.36, 0.46),
    "table_side": (0.45, 0.45, 0.5),
    "cabinet_drawers": (0.45, 0.6, 0.72),
    "cabinet_doors": (0.45, 0.8, 0.76),
    "fridge_body": (0.68, 0.6, 1.78),
    "oven_body": (0.6, 0.595, 0.6),
}
"""Size of the bounding box of each object, centred on its origin in x and y: depth (x), width (y), height (z), m."""

DOOR_HEIGHT = 2.0
_LEAF_THICKNESS = 0.04
_HINGE_OFFSET = 0.022
"""Distance from the jamb to the axis of a hinge, m."""
_SLIDING_WIDTH = 0.94
_SLIDING_LEAF = 0.035
_SLIDING_OFFSET = 0.05
_SLIDING_TRAVEL = 0.88


def is_door(body: Body) -> bool:
    """Returns whether a body is the leaf of a door."""
    return body.model.startswith(("door_", "sliding_door"))


def body_box(body: Body) -> Box:
    """Returns the axis-aligned bounding box of a body; that of a door leaf at its joint position."""
    if is_door(body):
        return Box(leaf_rect(body), body.position[2], body.position[2] + DOOR_HEIGHT + 0.1)
    depth, width, height = SIZES[body.model]
    return Box(
        rotated_bounds((body.position[0], body.position[1]), body.yaw, depth, width), body.position[2], body.position[2] + height
    )


def leaf_corners(body: Body) -> tuple[Point, ...]:
    """Returns the four corners of a door leaf at its joint position, seen from above."""
    yaw, x0, x1, half = body.yaw, -0.02, 0.874 if "90" in body.model else 0.774, _LEAF_THICKNESS / 2
    if body.model.startswith("sliding"):
        x0, half = body.joints.get("slide", 0.0), _SLIDING_LEAF / 2
        x1 = x0 + _SLIDING_WIDTH
    else:
        yaw += body.joints.get("hinge", 0.0) * (1 if body.model.endswith("left") else -1)
    cos, sin = math.cos(yaw), math.sin(yaw)
    return tuple(
        (body.position[0] + cos * x - sin * y, body.position[1] + sin * x + cos * y)
        for x, y in ((x0, -half), (x1, -half), (x1, half), (x0, half))
    )


def leaf_rect(body: Body) -> Rect:
    """Returns the bounding rectangle of a door leaf at its joint position."""
    return bounding_rect(leaf_corners(body))


def door_model(opening_width: float, swing: int, hinge: str) -> str:
    """Returns the name of a door's object; a leaf is left-handed if it rotates counter-clockwise as it opens."""
    hand = "left" if (swing > 0) == (hinge == "start") else "right"
    return f"door_{round(opening_width * 100)}_{hand}"


def door_body(name: str, wall: Wall, opening: Opening, floor_z: float, joint: float) -> Body:
    """Returns the body of a door leaf in its opening.

    Args:
        name: name of the body.
        wall: wall of the opening.
        opening: opening with ``body`` set.
        floor_z: height of the storey's floor, metres.
        joint: joint position, radians; metres for a sliding door.
    """
    length = math.dist(wall.start, wall.end)
    along = ((wall.end[0] - wall.start[0]) / length, (wall.end[1] - wall.start[1]) / length)
    side = (-along[1] * opening.swing, along[0] * opening.swing)
    sliding = opening.body.startswith("sliding")
    if sliding:
        # It slides towards its "hinge"; its closing edge is at the other end.
        at, direction = (
            (opening.middle + opening.width / 2 + 0.02, -1.0)
            if opening.hinge == "start"
            else (opening.middle - opening.width / 2 - 0.02, 1.0)
        )
        offset = wall.thickness / 2 + _SLIDING_OFFSET
    else:
        at, direction = (
            (opening.middle - opening.width / 2 + _HINGE_OFFSET, 1.0)
            if opening.hinge == "start"
            else (opening.middle + opening.width / 2 - _HINGE_OFFSET, -1.0)
        )
        offset = wall.thickness / 2 - _LEAF_THICKNESS / 2 - 0.005
    x = wall.start[0] + along[0] * at + side[0] * offset
    y = wall.start[1] + along[1] * at + side[1] * offset
    joints = {"slide": min(joint, _SLIDING_TRAVEL)} if sliding else {"hinge": joint}
    return Body(
        name,
        opening.body,
        (round(x, 4), round(y, 4), floor_z),
        round(math.atan2(along[1] * direction, along[0] * direction), 6) + 0.0,
        joints,
    )
