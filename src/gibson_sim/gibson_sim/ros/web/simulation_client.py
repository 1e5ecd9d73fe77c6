"""What a page asks of a simulation, by the services of ``simulation_interfaces``: any simulator that has them will do."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from geometry_msgs.msg import Pose
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import (
    DeleteEntity,
    GetEntitiesStates,
    GetNamedPoses,
    GetSimulationState,
    GetSpawnables,
    ResetSimulation,
    SetEntityState,
    SetSimulationState,
    SpawnEntity,
    StepSimulation,
)

from gibson_sim.types import WORLD_FRAME
from gibson_sim.web.pages import Answer
from gibson_sim.web.requests import Delete, Move, Rate, Request, Spawn, Time

STATES = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
    SimulationState.STATE_QUITTING: "quitting",
    SimulationState.STATE_NO_WORLD: "no world",
    SimulationState.STATE_LOADING_WORLD: "loading a world",
}
_SERVICES = {
    "delete_entity": DeleteEntity, "get_entities_states": GetEntitiesStates, "get_named_poses": GetNamedPoses,
    "get_simulation_state": GetSimulationState, "get_spawnables": GetSpawnables, "reset_simulation": ResetSimulation,
    "set_entity_state": SetEntityState, "set_simulation_state": SetSimulationState, "spawn_entity": SpawnEntity,
    "step_simulation": StepSimulation,
}  # fmt: skip
_OK = 1
"""``Result.RESULT_OK``."""
_DROP_M = 0.02
"""Height above the floor at which a spawned or moved entity begins, m."""
LATE_S, LOST_S = 5.0, 60.0
"""Wall time without an answer after which a page is told, and after which an answer is no longer awaited, s."""


@dataclass(slots=True)
class _Call:
    """A call of a service that has not been answered."""

    client: Any
    future: Any
    began_s: float
    late: Callable[[str], None] | None
    """Is called once with what to say if the answer is late; None = nobody is told."""


class SimulationClient:
    """Calls the services; never blocks."""

    def __init__(self, node: Node, physics: str = "physics") -> None:
        """``physics``: name of the node with the parameter ``rate``."""
        self._node, self._clients = node, {name: node.create_client(kind, name) for name, kind in _SERVICES.items()}
        self._parameters = node.create_client(SetParameters, f"{physics}/set_parameters")
        self._calls: list[_Call] = []

    def is_there(self) -> bool:
        """Returns whether a simulation answers in this domain."""
        return bool(self._clients["get_simulation_state"].service_is_ready())

    def ask(self, request: Request, floor_z: float, answer: Answer) -> None:
        """Does what a page asks for; ``answer`` is called once it is done.

        Args:
            request: of a page.
            floor_z: height of the floor that the page shows, metres.
            answer: (whether it worked, what to say).
        """
        if isinstance(request, Time):
            self._time(request, answer)
        elif isinstance(request, Rate):
            value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=request.value)
            self._call(
                self._parameters,
                SetParameters.Request(parameters=[Parameter(name="rate", value=value)]),
                partial(_parameter, answer),
                partial(answer, False),
            )
        elif isinstance(request, Spawn):
            message = spawn_request(request.uri, (request.x, request.y, request.yaw), floor_z)
            self._do("spawn_entity", message, answer, "spawned {response.entity_name}")
        elif isinstance(request, Move):
            message = move_request(request.name, (request.x, request.y, request.yaw), floor_z)
            self._do("set_entity_state", message, answer, "moved " + _literal(request.name))
        elif isinstance(request, Delete):
            self._do("delete_entity", DeleteEntity.Request(entity=request.name), answer, "deleted " + _literal(request.name))

    def get(self, service: str, request: Any, then: Callable[[Any], None]) -> None:
        """Calls ``then`` with the response of a service, where it answers and succeeds; not while the call before is unanswered."""
        client = self._clients[service]
        if not any(call.client is client and call.late is None for call in self._calls):
            self._call(client, request, lambda response: then(response) if response and response.result.result == _OK else None)

    def call(self, client: Any, request: Any, then: Callable[[Any], None], answer: Answer) -> None:
        """Calls any service; ``then`` gets its response, or None where nothing offers it; a late one is told by ``answer``."""
        self._call(client, request, then, partial(answer, False))

    def look(self) -> None:
        """Tells pages whose calls are late, and forgets calls that will never be answered."""
        now = time.monotonic()
        for call in list(self._calls):
            if call.late is not None and now - call.began_s > LATE_S:
                call.late(
                    f"{call.client.srv_name.lstrip('/')} has not answered for {LATE_S:.0f} s: its node may be busy, or hang"
                )
                call.late = _no_one
            if now - call.began_s > LOST_S:
                call.client.remove_pending_request(call.future)
                self._calls.remove(call)

    def _time(self, request: Time, answer: Answer) -> None:
        if request.action == "step":
            self._do("step_simulation", StepSimulation.Request(steps=request.steps), answer, "")
        elif request.action == "reset":
            self._do("reset_simulation", ResetSimulation.Request(), answer, "the simulation was reset")
        else:
            state = SimulationState.STATE_PLAYING if request.action == "play" else SimulationState.STATE_PAUSED
            self._do("set_simulation_state", SetSimulationState.Request(state=SimulationState(state=state)), answer, "")

    def _do(self, service: str, request: Any, answer: Answer, done: str) -> None:
        # Each service has codes of its own above 100: 101 is a taken name for spawn_entity.
        good = {_OK, SetSimulationState.Response.ALREADY_IN_TARGET_STATE} if service == "set_simulation_state" else {_OK}

        def then(response: Any) -> None:
            if response is None:
                answer(False, f"nothing offers the service {service}: does a simulation run in this ROS domain?")
            elif response.result.result not in good:
                answer(False, response.result.error_message or f"{service} failed with code {response.result.result}")
            else:
                answer(True, done.format(response=response))

        self._call(self._clients[service], request, then, partial(answer, False))

    def _call(self, client: Any, request: Any, then: Callable[[Any], None], late: Callable[[str], None] | None = None) -> None:
        if not client.service_is_ready():
            then(None)
            return
        call = _Call(client, client.call_async(request), time.monotonic(), late)
        self._calls.append(call)

        def done(future: Any) -> None:
            if call in self._calls:
                self._calls.remove(call)
                then(None if future.exception() else future.result())

        call.future.add_done_callback(done)


def _no_one(text: str) -> None:
    """Tells it to nobody: a page is told once."""


def _literal(text: str) -> str:
    """Returns a text that ``str.format`` leaves as it is."""
    return text.replace("{", "{{").replace("}", "}}")


def _parameter(answer: Answer, response: Any) -> None:
    results = response.results if response is not None else ()
    if not results:
        answer(False, "nothing has the parameter rate: does a simulation run in this ROS domain?")
    else:
        answer(bool(results[0].successful), results[0].reason)


def spawn_request(uri: str, at: tuple[float, float, float], floor_z: float, name: str = "") -> Any:
    """Returns the request of SpawnEntity, 1.x or 2.x, that puts a thing at x, y (m) and yaw (rad) of the map, on a floor at height ``floor_z``, m."""
    request = SpawnEntity.Request(name=name, allow_renaming=True)
    if hasattr(request, "entity_resource"):  # 2.x
        request.entity_resource.uri = uri
    else:
        request.uri = uri
    request.initial_pose.header.frame_id = WORLD_FRAME
    request.initial_pose.pose = flat_pose(at[0], at[1], floor_z + _DROP_M, at[2])
    return request


def move_request(name: str, at: tuple[float, float, float], floor_z: float) -> Any:
    """Returns the request of SetEntityState, 1.x or 2.x, that puts an entity there, as for ``spawn_request``, at rest."""
    request = SetEntityState.Request(entity=name)
    request.state.header.frame_id = WORLD_FRAME
    request.state.pose = flat_pose(at[0], at[1], floor_z + _DROP_M, at[2])
    for flag in ("set_pose", "set_twist"):  # 2.x; 1.x sets everything
        if hasattr(request, flag):
            setattr(request, flag, True)
    return request


def flat_pose(x: float, y: float, z: float, yaw: float) -> Pose:
    """Returns a level pose."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return pose
