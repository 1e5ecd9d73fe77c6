"""On which floor of a scene a point is. Must import neither ROS nor a physics engine."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from gibson_sim.scenes.spec import SceneSpec

_BELOW = 0.2
"""Distance below a floor within which a point still belongs to it, metres: bodies on an uneven floor. A slab is thicker."""


def floor_at(floors: Sequence[float], z: float) -> int:
    """Returns the index of the floor on which a point is: the highest that is at most 0.2 m above it, else the lowest.

    So a lamp at the ceiling belongs to the floor below it, and a robot on a staircase to the floor that it comes from going up.

    Args:
        floors: heights of the floors in increasing order, world metres; empty counts as one floor.
        z: height of the point, world metres.
    """
    return max((number for number, floor_z in enumerate(floors) if floor_z <= z + _BELOW), default=0)


def with_floor_at(scene: SceneSpec, z: float) -> SceneSpec:
    """Returns the scene with ``floor_z`` at the floor on which a point is; ``z``: height of the point, world metres."""
    floor_z = scene.floors[floor_at(scene.floors, z)]
    return scene if floor_z == scene.floor_z else replace(scene, floor_z=floor_z, other_floors=scene.floors)


def floor_name(scene: SceneSpec) -> str:
    """Returns the name of the floor at ``floor_z`` where a scene has several, such as ``floor 1``, 0 = the lowest; else an empty text."""
    return f"floor {scene.floors.index(scene.floor_z)}" if len(scene.floors) > 1 else ""
