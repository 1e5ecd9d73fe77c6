"""Defines objects with joints: doors, a window, cabinets, a fridge, an oven.

Doors and windows are fixed to the world; their origin is in the hinge, on the floor (for a window: on the sill), with the closed leaf along +x.
The others stand on their underside and face +x; ``static`` in a scene fixes them to the world.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from gibson_sim_tools.making.objects.model import ZERO, ObjectJoint, ObjectLink, ObjectModel, Primitive, box

WORLD = "world"
"""Empty root link of fixed objects."""
LEAF_THICKNESS = 0.04
"""Thickness of a door leaf, m."""
HANDLE_Z = 1.02
"""Height of a door handle, m."""
BOARD_THICKNESS = 0.018
"""Thickness of the boards of cabinets, m."""
_FIXED = ObjectLink(WORLD, 0.0, (), visual=False)


def door_names() -> tuple[str, ...]:
    """Returns the names of the hinged doors."""
    return tuple(f"door_{width}_{side}" for width in (80, 90) for side in ("left", "right"))


def _door(name: str, width: float, side: int) -> ObjectModel:
    """Returns a leaf for a clear opening of ``width``, m, with its axis 22 mm inside. ``side``: 1 = it swings to +y, -1 = to -y."""
    leaf_width = width - 0.026
    leaf = ObjectLink(
        "leaf", 22.0 * width / 0.8, (box((0.0, -LEAF_THICKNESS / 2, 0.006), (leaf_width, LEAF_THICKNESS / 2, 1.994)),), 0.45
    )
    handle = ObjectLink("handle", 0.5, lever(), 0.4, center=ZERO)
    return ObjectModel(
        name, "door", (leaf_width + LEAF_THICKNESS / 2, 0.144, 1.988), (_FIXED, leaf, handle),
        (
            ObjectJoint("hinge", "revolute", WORLD, "leaf", ZERO, (0.0, 0.0, float(side)), 0.0, math.radians(100.0), 2.5),
            ObjectJoint("handle", "revolute", "leaf", "handle", (leaf_width - 0.06, 0.0, HANDLE_Z), (0.0, -1.0, 0.0), 0.0, math.radians(40.0), 0.02),
        ),
        built_in=True,
    )  # fmt: skip


def lever() -> tuple[Primitive, ...]:
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
            ObjectJoint("rail", "fixed", WORLD, "rail", ZERO),
            ObjectJoint("slide", "prismatic", WORLD, "leaf", ZERO, (1.0, 0.0, 0.0), 0.0, 0.88, 12.0),
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
            ObjectJoint("frame", "fixed", WORLD, "frame", ZERO),
            ObjectJoint("hinge", "revolute", WORLD, "sash", (0.05, 0.035, 0.0), (0.0, 0.0, 1.0), 0.0, math.radians(90.0), 1.5),
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


DRAWERS_Z = (0.075, 0.285, 0.495)
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
    for number, z in enumerate(DRAWERS_Z, start=1):
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
