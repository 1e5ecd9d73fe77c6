"""Defines objects without joints, for tables and floors."""

from __future__ import annotations

from collections.abc import Sequence

from gibson_sim.types import Vec3
from gibson_sim_tools.making.objects.model import (
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
