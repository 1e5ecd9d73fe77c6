"""Builds client requests of ``simulation_interfaces``, 1.x or 2.x; does not send them."""

from __future__ import annotations

import math
from typing import Any

from geometry_msgs.msg import Pose
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import (
    DeleteEntity,
    GetEntities,
    GetEntitiesStates,
    GetEntityState,
    GetNamedPoses,
    GetSimulationState,
    GetSpawnables,
    LoadWorld,
    ResetSimulation,
    SetEntityState,
    SetSimulationState,
    SpawnEntity,
    StepSimulation,
)

from gibson_sim.types import WORLD_FRAME

STATES = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
    SimulationState.STATE_QUITTING: "quitting",
    SimulationState.STATE_NO_WORLD: "no world",
    SimulationState.STATE_LOADING_WORLD: "loading a world",
}
SERVICES: dict[str, Any] = {
    "delete_entity": DeleteEntity, "get_entities": GetEntities, "get_entities_states": GetEntitiesStates,
    "get_entity_state": GetEntityState, "get_named_poses": GetNamedPoses, "get_simulation_state": GetSimulationState,
    "get_spawnables": GetSpawnables, "load_world": LoadWorld, "reset_simulation": ResetSimulation, "set_entity_state": SetEntityState,
    "set_simulation_state": SetSimulationState, "spawn_entity": SpawnEntity, "step_simulation": StepSimulation,
}  # fmt: skip
"""Service name -> type."""
OK = 1
"""``Result.RESULT_OK``."""
DROP_M = 0.02
"""Height above the floor at which a spawned or moved entity is placed, m."""


def spawn_request(uri: str, at: tuple[float, float, float], floor_z: float, name: str = "") -> Any:
    """Returns the request of SpawnEntity, 1.x or 2.x, that places an entity on a floor.

    Args:
        uri: resource of the entity.
        at: x, y (m) and yaw (rad), map frame.
        floor_z: height of the floor, m.
        name: name of the entity; empty = the name in the resource.
    """
    request = SpawnEntity.Request(name=name, allow_renaming=True)
    if hasattr(request, "entity_resource"):  # 2.x
        request.entity_resource.uri = uri
    else:
        request.uri = uri
    request.initial_pose.header.frame_id = WORLD_FRAME
    request.initial_pose.pose = flat_pose(at[0], at[1], floor_z + DROP_M, at[2])
    return request


def move_request(name: str, at: tuple[float, float, float], floor_z: float) -> Any:
    """Returns the request of SetEntityState, 1.x or 2.x, that places an entity at rest; arguments as for ``spawn_request``."""
    request = SetEntityState.Request(entity=name)
    request.state.header.frame_id = WORLD_FRAME
    request.state.pose = flat_pose(at[0], at[1], floor_z + DROP_M, at[2])
    for flag in ("set_pose", "set_twist"):  # 2.x; 1.x sets everything
        if hasattr(request, flag):
            setattr(request, flag, True)
    return request


def state_request(state: int) -> Any:
    """Returns the request of SetSimulationState; ``state`` is a key of ``STATES``."""
    return SetSimulationState.Request(state=SimulationState(state=state))


def flat_pose(x: float, y: float, z: float, yaw: float) -> Pose:
    """Returns a pose with roll and pitch 0; m and rad."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return pose
