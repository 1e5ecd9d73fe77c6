"""Defines the built-in objects, and writes their table in docs/objects.md.

Objects with joints are doors, a window, cabinets, a fridge, an oven; objects without joints are for tables and floors. Doors and windows are
fixed to the world; their origin is in the hinge, on the floor (for a window: on the sill), with the closed leaf along +x. The other objects with
joints stand on their underside and face +x; ``static`` in a scene fixes them to the world.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim.types import Vec3
from gibson_sim_tools.making.objects.model import (
    ZERO,
    ObjectJoint,
    ObjectLink,
    ObjectModel,
    Primitive,
    box,
    cylinder,
    resting_sphere,
    ring_wall,
)

_ROLLING = 0.0015
"""Coefficient of rolling friction of a smooth round object on its side, m."""
_WORLD = "world"
"""Empty root link of fixed objects."""
LEAF_THICKNESS = 0.04
"""Thickness of a door leaf, m."""
HANDLE_Z = 1.02
"""Height of a door handle, m."""
BOARD_THICKNESS = 0.018
"""Thickness of the boards of cabinets, m."""
_FIXED = ObjectLink(_WORLD, 0.0, (), visual=False)
_HEADER = "| object | class | depth x width x height, m | mass, kg | joints |\n|---|---|---|---|---|"


def door_names() -> tuple[str, ...]:
    """Returns the names of the hinged doors."""
    return tuple(f"door_{width}_{side}" for width in (80, 90) for side in ("left", "right"))


def _door(name: str, width: float, side: int) -> ObjectModel:
    """Returns a leaf for a clear opening of ``width``, m, with its axis 22 mm inside. ``side``: 1 = it swings to +y, -1 = to -y."""
    leaf_width = width - 0.026
    leaf = ObjectLink(
        "leaf", 22.0 * width / 0.8, (box((0.0, -LEAF_THICKNESS / 2, 0.006), (leaf_width, LEAF_THICKNESS / 2, 1.994)),), 0.45
    )
    handle = ObjectLink("handle", 0.5, _lever(), 0.4, center=ZERO)
    return ObjectModel(
        name, "door", (leaf_width + LEAF_THICKNESS / 2, 0.144, 1.988), (_FIXED, leaf, handle),
        (
            ObjectJoint("hinge", "revolute", _WORLD, "leaf", ZERO, (0.0, 0.0, float(side)), 0.0, math.radians(100.0), 2.5),
            ObjectJoint("handle", "revolute", "leaf", "handle", (leaf_width - 0.06, 0.0, HANDLE_Z), (0.0, -1.0, 0.0), 0.0, math.radians(40.0), 0.02),
        ),
        built_in=True,
    )  # fmt: skip


def _lever() -> tuple[Primitive, ...]:
    """Returns a spindle with a lever at each end, pointing to the hinge; the origin is on its axis."""
    spindle = Primitive("cylinder", (0.009, 0.126, 0.0), ZERO, (math.pi / 2, 0.0, 0.0))
    return (spindle, *(box((-0.125, side * 0.054, -0.009), (0.009, side * 0.072, 0.009)) for side in (-1, 1)))


def _sliding_door() -> ObjectModel:
    leaf = ObjectLink(
        "leaf", 24.0, (box((0.0, -0.0175, 0.008), (0.94, 0.0175, 2.028)), box((0.053, 0.036, 0.9), (0.072, 0.054, 1.2))), 0.45
    )
    rail = ObjectLink("rail", 2.0, (box((0.0, -0.022, 2.05), (1.84, 0.022, 2.09)),), 0.4)
    return ObjectModel(
        "sliding_door_90", "door", (1.84, 0.077, 2.082), (_FIXED, rail, leaf),
        (
            ObjectJoint("rail", "fixed", _WORLD, "rail", ZERO),
            ObjectJoint("slide", "prismatic", _WORLD, "leaf", ZERO, (1.0, 0.0, 0.0), 0.0, 0.88, 12.0),
        ),
        built_in=True,
    )  # fmt: skip


def _window() -> ObjectModel:
    """Returns a frame of 0.80 x 1.20 m with one sash, hinged at x = 0.05 on the side +y."""
    frame = ObjectLink("frame", 8.0, _rim(0.0, 0.8, 0.0, 1.2, 0.05, 0.035), 0.4)
    # The axis is at the inner edge of the sash, so that it swings clear of its frame.
    sash_width, low, high = 0.7, 0.05, 1.15
    sash = ObjectLink("sash", 14.0, (box((0.004, -0.055, low + 0.004), (sash_width - 0.004, -0.005, high - 0.004)),), 0.4)
    handle = ObjectLink(
        "handle",
        0.2,
        (box((-0.01, 0.0, -0.01), (0.01, 0.04, 0.01)), box((-0.009, 0.028, -0.12), (0.009, 0.043, 0.0))),
        0.4,
        center=ZERO,
    )
    return ObjectModel(
        "window_casement", "window", (0.8, 0.108, 1.2), (_FIXED, frame, sash, handle),
        (
            ObjectJoint("frame", "fixed", _WORLD, "frame", ZERO),
            ObjectJoint("hinge", "revolute", _WORLD, "sash", (0.05, 0.035, 0.0), (0.0, 0.0, 1.0), 0.0, math.radians(90.0), 1.5),
            ObjectJoint("handle", "revolute", "sash", "handle", (sash_width - 0.03, -0.005, 0.6), (0.0, 1.0, 0.0), 0.0, math.radians(90.0), 0.01),
        ),
        built_in=True,
    )  # fmt: skip


def _rim(x0: float, x1: float, z0: float, z1: float, width: float, half_depth: float) -> tuple[Primitive, ...]:
    """Returns the four sides of an upright frame."""
    d = half_depth
    return (
        box((x0, -d, z0), (x0 + width, d, z1)),
        box((x1 - width, -d, z0), (x1, d, z1)),
        box((x0 + width, -d, z0), (x1 - width, d, z0 + width)),
        box((x0 + width, -d, z1 - width), (x1 - width, d, z1)),
    )


def carcass(x0: float, x1: float, width: float, z0: float, z1: float, wall: float) -> tuple[Primitive, ...]:
    """Returns back, sides, bottom and top of a cabinet with an open front."""
    y = width / 2
    return (
        box((x0, -y, z0), (x0 + wall, y, z1)),
        box((x0 + wall, -y, z0), (x1, -y + wall, z1)),
        box((x0 + wall, y - wall, z0), (x1, y, z1)),
        box((x0 + wall, -y + wall, z0), (x1, y - wall, z0 + wall)),
        box((x0 + wall, -y + wall, z1 - wall), (x1, y - wall, z1)),
    )


_DRAWERS_Z = (0.075, 0.285, 0.495)
"""Heights of the lower edges of the drawer fronts, m."""
DRAWER_HEIGHT = 0.204
_DRAWER_DEPTH = 0.37


def _cabinet_drawers() -> ObjectModel:
    links = [
        ObjectLink(
            "body",
            19.0,
            (*carcass(-0.225, 0.177, 0.6, 0.06, 0.72, BOARD_THICKNESS), box((-0.2, -0.28, 0.0), (0.13, 0.28, 0.06))),
            0.5,
        )
    ]
    joints = []
    for number, z in enumerate(_DRAWERS_Z, start=1):
        links.append(ObjectLink(f"drawer_{number}", 3.2, _drawer(), 0.5, mesh="drawer"))
        joints.append(
            ObjectJoint(
                f"drawer_{number}", "prismatic", "body", f"drawer_{number}", (0.177, 0.0, z), (1.0, 0.0, 0.0), 0.0, 0.32, 15.0
            )
        )
    return ObjectModel("cabinet_drawers", "cabinet", (0.45, 0.6, 0.72), tuple(links), tuple(joints))


def _drawer() -> tuple[Primitive, ...]:
    """Returns a drawer; its origin is at the lower back edge of its front."""
    y, back, top = 0.265, -_DRAWER_DEPTH, 0.16
    return (
        box((0.0, -0.297, 0.0), (BOARD_THICKNESS, 0.297, DRAWER_HEIGHT)),
        box((back, -y, 0.015), (0.0, y, 0.024)),
        box((back, -y, 0.024), (back + 0.012, y, top)),
        box((back + 0.012, -y, 0.024), (0.0, -y + 0.012, top)),
        box((back + 0.012, y - 0.012, 0.024), (0.0, y, top)),
        box((BOARD_THICKNESS + 0.018, -0.08, 0.125), (BOARD_THICKNESS + 0.03, 0.08, 0.137)),
    )


def _cabinet_doors() -> ObjectModel:
    shelf = box((-0.207, -0.382, 0.40), (0.16, 0.382, 0.418))
    body = ObjectLink(
        "body",
        24.0,
        (*carcass(-0.225, 0.177, 0.8, 0.06, 0.76, BOARD_THICKNESS), shelf, box((-0.2, -0.38, 0.0), (0.13, 0.38, 0.06))),
        0.5,
    )
    links, joints = [body], []
    for name, side in (("door_left", 1), ("door_right", -1)):
        leaf = box((0.0, -side * 0.002, 0.062), (BOARD_THICKNESS, -side * 0.3985, 0.758))
        bar = box((BOARD_THICKNESS + 0.018, -side * 0.36, 0.38), (BOARD_THICKNESS + 0.03, -side * 0.372, 0.54))
        links.append(ObjectLink(name, 4.5, (leaf, bar), 0.5))
        joints.append(
            ObjectJoint(
                name, "revolute", "body", name, (0.177, side * 0.4, 0.0), (0.0, 0.0, float(side)), 0.0, math.radians(110.0), 0.6
            )
        )
    return ObjectModel("cabinet_doors", "cabinet", (0.45, 0.8, 0.76), tuple(links), tuple(joints))


def _fridge() -> ObjectModel:
    shelves = tuple(box((-0.29, -0.26, z), (0.2, 0.26, z + 0.008)) for z in (0.5, 0.85, 1.2))
    body = ObjectLink(
        "body", 48.0, (*carcass(-0.34, 0.25, 0.6, 0.02, 1.78, 0.04), box((-0.3, -0.28, 0.0), (0.22, 0.28, 0.02)), *shelves), 0.5
    )
    door = ObjectLink(
        "door", 12.0,
        (box((0.004, 0.002, 0.045), (0.06, 0.598, 1.775)), box((0.078, 0.54, 0.85), (0.09, 0.56, 1.35)),
         *(box((-0.09, 0.06, z), (-0.002, 0.54, z + 0.012)) for z in (0.35, 0.75, 1.15))), 0.5,
    )  # fmt: skip
    joint = ObjectJoint("door", "revolute", "body", "door", (0.25, -0.3, 0.0), (0.0, 0.0, -1.0), 0.0, math.radians(115.0), 2.0)
    return ObjectModel("fridge_body", "fridge", (0.68, 0.6, 1.78), (body, door), (joint,))


def _oven() -> ObjectModel:
    """Returns an oven. The axis of its door is at the lower front edge: gravity holds it closed, and open."""
    rack = box((-0.26, -0.23, 0.27), (0.2, 0.23, 0.276))
    panel = box((0.23, -0.2975, 0.49), (0.265, 0.2975, 0.6))
    body = ObjectLink("body", 30.0, (*carcass(-0.3, 0.23, 0.595, 0.0, 0.6, 0.045), rack, panel), 0.5)
    door = ObjectLink(
        "door", 5.5, (box((-0.034, -0.29, 0.005), (0.0, 0.29, 0.42)), box((0.02, -0.24, 0.375), (0.035, 0.24, 0.39))), 0.5
    )  # fmt: skip
    joint = ObjectJoint("door", "revolute", "body", "door", (0.265, 0.0, 0.065), (0.0, 1.0, 0.0), 0.0, math.radians(90.0), 2.5)
    return ObjectModel("oven_body", "oven", (0.6, 0.595, 0.6), (body, door), (joint,))


def _doors() -> Sequence[ObjectModel]:
    return [_door(name, int(name[5:7]) / 100, 1 if name.endswith("left") else -1) for name in door_names()]


JOINED: tuple[ObjectModel, ...] = (
    *_doors(), _sliding_door(), _cabinet_drawers(), _cabinet_doors(), _fridge(), _oven(), _window(),
)  # fmt: skip


def _body(
    name: str,
    semantic_class: str,
    size: Vec3,
    mass: float,
    primitives: Sequence[Primitive],
    friction: float = 0.5,
    rolling: float = 0.0,
) -> ObjectModel:
    return ObjectModel(name, semantic_class, size, (ObjectLink("body", mass, tuple(primitives), friction, rolling),))


def _resting_box(size: Vec3) -> Primitive:
    """Returns a box centred on the z axis that rests on z = 0."""
    x, y, z = size
    return box((-x / 2, -y / 2, 0.0), (x / 2, y / 2, z))


def _crate(size: Vec3, wall: float, base: float) -> tuple[Primitive, ...]:
    """Returns four walls and a base, open at the top."""
    x, y, z = size[0] / 2, size[1] / 2, size[2]
    return (
        box((-x, -y, 0.0), (x, y, base)),
        box((-x, -y, base), (-x + wall, y, z)),
        box((x - wall, -y, base), (x, y, z)),
        box((-x + wall, -y, base), (x - wall, -y + wall, z)),
        box((-x + wall, y - wall, base), (x - wall, y, z)),
    )


def _legs(x: float, y: float, edge: float, high: float) -> tuple[Primitive, ...]:
    """Returns four square legs, centred at (+-x, +-y), m."""
    e = edge / 2
    return tuple(box((sx * x - e, sy * y - e, 0.0), (sx * x + e, sy * y + e, high)) for sx in (-1, 1) for sy in (-1, 1))


_BOOK_A: Vec3 = (0.155, 0.225, 0.030)
_BOOK_B: Vec3 = (0.130, 0.195, 0.022)
LOOSE: tuple[ObjectModel, ...] = (
    _body("bottle_water", "bottle", (0.066, 0.066, 0.235), 0.53, (cylinder(0.033, 0.0, 0.165), cylinder(0.014, 0.165, 0.235)), 0.5, _ROLLING),
    _body("bottle_wine", "bottle", (0.076, 0.076, 0.31), 1.25, (cylinder(0.038, 0.0, 0.19), cylinder(0.015, 0.19, 0.31)), 0.5, _ROLLING),
    _body("can_soda", "can", (0.066, 0.066, 0.116), 0.35, (cylinder(0.033, 0.0, 0.116),), 0.45, _ROLLING),
    _body("can_food", "can", (0.075, 0.075, 0.11), 0.46, (cylinder(0.0375, 0.0, 0.11),), 0.45, _ROLLING),
    _body("cup", "cup", (0.08, 0.108, 0.062), 0.17, (cylinder(0.038, 0.0, 0.062), box((-0.005, 0.036, 0.012), (0.005, 0.068, 0.052))), 0.5, _ROLLING),
    _body("mug", "cup", (0.082, 0.122, 0.096), 0.33, (cylinder(0.041, 0.0, 0.096), box((-0.006, 0.04, 0.018), (0.006, 0.081, 0.08))), 0.5, _ROLLING),
    _body("bowl", "bowl", (0.16, 0.16, 0.068), 0.36, (cylinder(0.045, 0.0, 0.012), *ring_wall(0.05, 0.08, 0.006, 0.068, 0.006)), 0.5, _ROLLING),
    _body("plate", "plate", (0.26, 0.26, 0.024), 0.55, (cylinder(0.085, 0.0, 0.01), *ring_wall(0.088, 0.13, 0.006, 0.024, 0.005)), 0.5, _ROLLING),
    _body("glass_tumbler", "glass", (0.074, 0.074, 0.12), 0.24, (cylinder(0.034, 0.0, 0.06), cylinder(0.037, 0.06, 0.12)), 0.45, _ROLLING),
    _body("book_a", "book", _BOOK_A, 0.62, (_resting_box(_BOOK_A),), 0.55),
    _body("book_b", "book", _BOOK_B, 0.31, (_resting_box(_BOOK_B),), 0.55),
    _body("book_stack", "book", (0.175, 0.245, 0.098), 1.9, (_resting_box((0.168, 0.235, 0.098)),), 0.55),
    _body("box_cereal", "box", (0.07, 0.19, 0.29), 0.42, (_resting_box((0.07, 0.19, 0.29)),), 0.5),
    _body("box_small", "box", (0.12, 0.18, 0.09), 0.25, (_resting_box((0.12, 0.18, 0.09)),), 0.5),
    _body("box_cardboard", "box", (0.3, 0.4, 0.28), 2.4, (_resting_box((0.3, 0.4, 0.28)),), 0.55),
    _body(
        "vase", "vase", (0.14, 0.14, 0.28), 0.95,
        (cylinder(0.042, 0.0, 0.05), cylinder(0.068, 0.05, 0.17), cylinder(0.035, 0.17, 0.28)), 0.5, _ROLLING,
    ),
    _body("candle", "candle", (0.07, 0.07, 0.1), 0.27, (cylinder(0.035, 0.0, 0.088),), 0.55, _ROLLING),
    _body(
        "teapot", "teapot", (0.15, 0.258, 0.15), 0.78,
        (cylinder(0.055, 0.0, 0.03), cylinder(0.074, 0.03, 0.10), cylinder(0.04, 0.10, 0.15), box((-0.008, -0.125, 0.06), (0.008, -0.07, 0.105)),
         box((-0.006, 0.07, 0.035), (0.006, 0.125, 0.115))), 0.5, _ROLLING,
    ),
    _body(
        "laptop", "laptop", (0.31, 0.33, 0.21), 1.45,
        (box((-0.115, -0.165, 0.0), (0.12, 0.165, 0.018)), Primitive("box", (0.008, 0.33, 0.215), (-0.1525, 0.0, 0.113), (0.0, -0.33, 0.0))), 0.6,
    ),
    _body("keyboard", "keyboard", (0.14, 0.44, 0.028), 0.62, (_resting_box((0.14, 0.44, 0.022)),), 0.6),
    _body("remote_control", "remote_control", (0.17, 0.046, 0.022), 0.12, (_resting_box((0.17, 0.046, 0.02)),), 0.55),
    _body("fruit_apple", "fruit", (0.075, 0.075, 0.075), 0.17, (Primitive("sphere", (0.0345, 0.0, 0.0), (0.0, 0.0, 0.0345)),), 0.5, 0.004),
    _body("fruit_orange", "fruit", (0.076, 0.076, 0.076), 0.19, (resting_sphere(0.038),), 0.55, 0.003),
    _body("toy_ball", "ball", (0.12, 0.12, 0.12), 0.09, (resting_sphere(0.06),), 0.6, 0.002),
    _body("ball", "ball", (0.22, 0.22, 0.22), 0.43, (resting_sphere(0.11),), 0.6, 0.002),
    _body("pen_cup", "pen_cup", (0.085, 0.085, 0.19), 0.24, (cylinder(0.042, 0.0, 0.105), cylinder(0.02, 0.105, 0.18)), 0.5, _ROLLING),
    _body(
        "clock", "clock", (0.05, 0.14, 0.145), 0.32,
        (Primitive("cylinder", (0.068, 0.045, 0.0), (0.0, 0.0, 0.077), (0.0, 1.5707963, 0.0)), box((-0.025, -0.05, 0.0), (0.025, 0.05, 0.02))), 0.5,
    ),
    _body("bin_waste", "bin", (0.28, 0.28, 0.33), 0.9, (cylinder(0.1, 0.0, 0.012), *ring_wall(0.105, 0.14, 0.006, 0.33, 0.008)), 0.5, 0.002),
    _body("basket", "basket", (0.3, 0.4, 0.23), 0.8, _crate((0.3, 0.4, 0.23), 0.012, 0.012), 0.6),
    _body(
        "chair_wooden", "chair", (0.5, 0.44, 0.88), 4.6,
        (*_legs(0.205, 0.19, 0.036, 0.43), box((-0.22, -0.22, 0.43), (0.24, 0.22, 0.455)),
         Primitive("box", (0.025, 0.40, 0.44), (-0.227, 0.0, 0.66), (0.0, -0.09, 0.0))), 0.45,
    ),
    _body("stool", "stool", (0.36, 0.36, 0.46), 3.1, (*_legs(0.135, 0.135, 0.036, 0.43), cylinder(0.18, 0.43, 0.46)), 0.45),
    _body(
        "table_side", "table", (0.45, 0.45, 0.5), 5.5,
        (*_legs(0.195, 0.195, 0.036, 0.475), box((-0.225, -0.225, 0.475), (0.225, 0.225, 0.5))), 0.45,
    ),
)  # fmt: skip
OBJECTS: dict[str, ObjectModel] = {model.name: model for model in (*LOOSE, *JOINED)}
"""Objects by name, in the order of the table in docs/objects.md."""


def objects_table(models: Sequence[ObjectModel]) -> str:
    """Returns a Markdown table of names, classes, sizes, masses and joints."""
    return "\n".join([_HEADER, *(_row(model) for model in models)])


def _row(model: ObjectModel) -> str:
    size = " x ".join(f"{edge:.3f}" for edge in model.size)
    joints = ", ".join(_joint(joint) for joint in model.joints if joint.kind != "fixed") or "none"
    return f"| `{model.name}` | {model.semantic_class} | {size} | {model.mass:.3g} | {joints} |"


def _joint(joint: ObjectJoint) -> str:
    if joint.kind == "prismatic":
        return f"`{joint.name}` {joint.lower:g} to {joint.upper:g} m"
    return f"`{joint.name}` {math.degrees(joint.lower):.0f} to {math.degrees(joint.upper):.0f}°"
