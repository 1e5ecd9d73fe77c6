"""The client of a simulation's services: ``simulation_interfaces``, 1.x or 2.x, of any simulator that offers them, and those of our other nodes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import Pose
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.node import Node
from simulation_interfaces.msg import Result, SimulationState
from simulation_interfaces.srv import SetEntityState, SetSimulationState, SpawnEntity

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.topics.discovery import offered_service
from gibson_sim.ros.wire.message_types import service_class, type_name_of
from gibson_sim.settings import nearest
from gibson_sim.types import WORLD_FRAME

__tracebackhide__ = True
"""pytest shows the line of the test, not those of this module; ``--full-trace`` shows all."""
OK = Result.RESULT_OK
STATES = {
    SimulationState.STATE_STOPPED: "stopped",
    SimulationState.STATE_PLAYING: "playing",
    SimulationState.STATE_PAUSED: "paused",
    SimulationState.STATE_QUITTING: "quitting",
    SimulationState.STATE_NO_WORLD: "no world",
    SimulationState.STATE_LOADING_WORLD: "loading a world",
}
DROP_M = 0.02
"""Height above the floor at which a spawned or moved entity is placed, m."""
LATE_S, LOST_S = 5.0, 60.0
"""Time without a response after which ``check_pending`` reports a call as late, and after which it drops it, s of wall time."""
_REPEAT_S = 1.0
"""Time without a response after which ``poll`` repeats its request, s of wall time."""


@dataclass(frozen=True, slots=True)
class Awaited:
    """What a blocking call waits for: a node that offers a service, then its response."""

    service: str
    """Full name of the service."""
    kind: Any
    """Class of the service."""
    is_sent: bool
    """Whether the request was sent, so that its response is awaited."""

    def __str__(self) -> str:
        return f"{'response of' if self.is_sent else 'service'} {self.service}"


Wait = Callable[[Callable[[], bool], Awaited], None]
"""Spins the node until the condition holds; raises a GibsonSimError with a text of its own if that takes too long."""


class SimulationClient:
    """Calls services for a node.

    It has no thread and does not spin: responses arrive while the owner spins the node, in the owner's thread. All users have one thread and one
    executor, but each waits in its own way: a node until Ctrl-C, a test until the simulation or a program ends, a lockstep participant only while
    it lets no tick pass, and the live page not at all. A client with a thread of its own would run callbacks of the node between any two
    statements of the owner, and in lockstep equal calls would no longer give equal values. A call is therefore only begun here (``begin``, ``poll``),
    and every method that returns a response waits by a function of the owner, which also has the time-outs and what to do about them.

    A refused request raises a GibsonSimError with the simulation's reason and, for the name of an entity, the nearest known one. A service of
    ``simulation_interfaces`` is given by its name; the class of any other one is that of its request.
    """

    def __init__(self, node: Node, wait: Wait | None = None, *, names_service: bool = False) -> None:
        """Creates no client of a service yet.

        Args:
            node: node of the clients; its owner spins it.
            wait: waits for a call; None = no blocking method is used.
            names_service: whether the error for a refused request begins with the full name of the service: for requests that no user made.
        """
        self._node, self._wait, self._names_service = node, wait, names_service
        self._clients: dict[str, Any] = {}
        self._calls: list[_Call] = []
        self._polled: dict[str, _Poll] = {}

    # Without waiting

    def prepare(self, service: str, kind: Any = None) -> None:
        """Creates the client of a service now, so that it is discovered before the first call.

        Args:
            service: name of the service.
            kind: its class; None = it is a standard one.
        """
        self._client(service, standard_service(service) if kind is None else kind)

    def is_offered(self, service: str) -> bool:
        """Returns whether a node offers a service, and is discovered."""
        if service not in self._clients:
            self.prepare(service)
        return bool(self._clients[service].service_is_ready())

    def begin(
        self, service: str, request: Any, on_response: Callable[[Any], None], on_late: Callable[[str], None] | None = None
    ) -> None:
        """Calls a service without waiting.

        Args:
            service: name of the service.
            request: its request.
            on_response: called with the response; or with None, immediately if no node offers the service, or if the call fails.
            on_late: called with a text if the response is late, see ``check_pending``; None = nothing is reported.
        """
        client = self._client(service, _class_of(request))
        if not client.service_is_ready():
            on_response(None)
            return
        call = _Call(service, client, client.call_async(request), time.monotonic(), on_late)
        self._calls.append(call)

        def on_done(future: Any) -> None:
            if call in self._calls:
                self._calls.remove(call)
                on_response(None if future.exception() else future.result())

        call.future.add_done_callback(on_done)

    def is_pending(self, service: str) -> bool:
        """Returns whether a call of ``begin`` waits for its response."""
        return any(call.service == service for call in self._calls)

    def check_pending(self) -> None:
        """Reports late calls of ``begin`` once, and drops those that have timed out."""
        now = time.monotonic()
        for call in list(self._calls):
            if call.on_late is not None and now - call.start_s > LATE_S:
                call.on_late(
                    f"{call.client.srv_name.lstrip('/')} has not answered for {LATE_S:.0f} s: its node may be busy, or hang"
                )
                call.on_late = None
            if now - call.start_s > LOST_S:
                call.client.remove_pending_request(call.future)
                self._calls.remove(call)

    def poll(self, service: str) -> Any:
        """Returns the response of a standard service to an empty request; None = it has not arrived: call this again after the node was spun.

        The service is found by its type, since a simulation may have renamed it (``service_prefix``). The request is repeated while it has no
        response: one can be lost if the simulation has not discovered the client yet.
        """
        polled = self._polled.setdefault(service, _Poll())
        kind = standard_service(service)
        if polled.client is None and (name := offered_service(self._node, kind)):
            polled.client = self._node.create_client(kind, name)
        if polled.future is not None and polled.future.done():
            return polled.future.result()
        is_due = polled.future is None or time.monotonic() - polled.start_s > _REPEAT_S
        if is_due and polled.client is not None and polled.client.service_is_ready():
            polled.future, polled.start_s = polled.client.call_async(kind.Request()), time.monotonic()
        return None

    # Blocking

    def discover(self, service: str, kind: Any = None) -> None:
        """Waits until a node offers a service; arguments as for ``prepare``."""
        self.prepare(service, kind)
        client = self._clients[service]
        self._wait_for(client.service_is_ready, Awaited(client.srv_name, client.srv_type, is_sent=False))

    def send(self, service: str, request: Any) -> Any:
        """Sends a request once a node offers the service; returns the future of the response."""
        self.discover(service, _class_of(request))
        return self._clients[service].call_async(request)

    def call(self, service: str, request: Any) -> Any:
        """Returns the response of a service, whatever its result.

        Raises:
            GibsonSimError: no node offers the service, or it does not respond.
        """
        future, client = self.send(service, request), self._clients[service]
        self._wait_for(future.done, Awaited(client.srv_name, client.srv_type, is_sent=True))
        return future.result()

    def ask(self, service: str, request: Any = None, **fields: Any) -> Any:
        """Returns the response of a standard service to a request, or to one with these fields.

        Raises:
            GibsonSimError: see ``call``; or the request is refused.
        """
        response = self.call(service, standard_service(service).Request(**fields) if request is None else request)
        if response.result.result != OK:
            raise self._refusal(service, response)
        return response

    def spawn(self, uri: str, at: tuple[float, float, float], floor_z: float, name: str = "") -> str:
        """Spawns an entity on the floor, and returns its name.

        Args:
            uri: resource of the entity.
            at: x, y (m) and yaw (rad), map frame.
            floor_z: height of the floor, m.
            name: name of the entity; empty = the name in the resource. Either gets a number if it exists.
        """
        response = self.call("spawn_entity", spawn_request(floor_pose(at, floor_z), name, uri, allow_renaming=True))
        if response.result.result != OK:
            known = [spawnable.uri for spawnable in self.ask("get_spawnables").spawnables]
            raise self._refusal("spawn_entity", response, uri, known)
        return str(response.entity_name)

    def move(self, name: str, at: tuple[float, float, float], floor_z: float) -> None:
        """Moves an entity to another place on the floor, at rest; arguments as for ``spawn``."""
        self._call_for_entity("set_entity_state", name, move_request(name, floor_pose(at, floor_z)))

    def delete(self, name: str) -> None:
        """Removes an entity."""
        self._call_for_entity("delete_entity", name, standard_service("delete_entity").Request(entity=name))

    def pose(self, name: str) -> Any:
        """Returns the geometry_msgs/Pose of an entity in the world frame."""
        request = standard_service("get_entity_state").Request(entity=name)
        return self._call_for_entity("get_entity_state", name, request).state.pose

    def entities(self) -> tuple[str, ...]:
        """Returns the names of all entities."""
        return tuple(self.ask("get_entities").entities)

    def poses(self) -> Mapping[str, Any]:
        """Returns the geometry_msgs/Pose of each entity in the world frame."""
        response = self.ask("get_entities_states")
        return {name: state.pose for name, state in zip(response.entities, response.states, strict=True)}

    @property
    def state(self) -> int:
        """State of the simulation, a key of ``STATES``."""
        return int(self.ask("get_simulation_state").state.state)

    def play(self) -> bool:
        """Lets time pass; returns whether the state has changed."""
        return self._set_state(SimulationState.STATE_PLAYING)

    def pause(self) -> bool:
        """Pauses the simulation; returns whether the state has changed."""
        return self._set_state(SimulationState.STATE_PAUSED)

    def step(self, steps: int) -> None:
        """Executes physics steps of a paused simulation."""
        self.ask("step_simulation", steps=steps)

    def reset(self, scope: int = 0) -> None:
        """Resets what ``scope`` names, a constant of ResetSimulation; 0 = the default of the simulation."""
        self.ask("reset_simulation", scope=scope)

    def set_parameter(self, node: str, name: str, value: float) -> tuple[bool, str]:
        """Sets a parameter of type double; returns whether it was set, and the reason if it was not."""
        result = self.call(f"{node}/set_parameters", parameter_request(name, value)).results[0]
        return bool(result.successful), str(result.reason)

    def _wait_for(self, condition: Callable[[], bool], awaited: Awaited) -> None:
        assert self._wait is not None, "this client does not block: use begin"
        self._wait(condition, awaited)

    def _set_state(self, state: int) -> bool:
        response = self.call("set_simulation_state", state_request(state))
        if not is_success("set_simulation_state", response):
            raise self._refusal("set_simulation_state", response)
        return bool(response.result.result == OK)

    def _call_for_entity(self, service: str, name: str, request: Any) -> Any:
        response = self.call(service, request)
        if response.result.result != OK:
            raise self._refusal(service, response, name, self.entities())
        return response

    def _refusal(self, service: str, response: Any, name: str = "", known: Any = ()) -> GibsonSimError:
        text = refusal_text(service, response) + (f" for {quoted(name)}" if name and not response.result.error_message else "")
        hint = nearest(name, known) if name and name not in known and "did you mean" not in text else ""
        prefix = f"{self._clients[service].srv_name}: " if self._names_service else ""
        return GibsonSimError(prefix + text + (f"; {hint}" if hint else ""))

    def _client(self, service: str, kind: Any) -> Any:
        if service not in self._clients:
            self._clients[service] = self._node.create_client(kind, service)
        return self._clients[service]


@dataclass(slots=True, eq=False)
class _Call:
    """A pending call of ``begin``."""

    service: str
    client: Any
    future: Any
    start_s: float
    on_late: Callable[[str], None] | None
    """Called once with a text if the response is late; None = no notice."""


@dataclass(slots=True)
class _Poll:
    """What is known of a polled service."""

    client: Any = None
    future: Any = None
    start_s: float = 0.0
    """Wall time of the last request, s (monotonic)."""


def standard_service(name: str) -> Any:
    """Returns the class of a service of ``simulation_interfaces``: that of ``spawn_entity`` is SpawnEntity."""
    return service_class(f"simulation_interfaces/srv/{''.join(word.capitalize() for word in name.split('_'))}")


def is_success(service: str, response: Any) -> bool:
    """Returns whether a request was fulfilled. Codes above 100 are specific to a service: 101 of spawn_entity is a name that is not unique."""
    codes = {OK, SetSimulationState.Response.ALREADY_IN_TARGET_STATE} if service == "set_simulation_state" else {OK}
    return response.result.result in codes


def refusal_text(service: str, response: Any) -> str:
    """Returns the reason of a simulation that refused a request."""
    return response.result.error_message or f"{service} failed with code {response.result.result}"


def _class_of(request: Any) -> Any:
    return service_class(type_name_of(type(request)))


# Requests


def spawn_request(pose: Pose, name: str = "", uri: str = "", text: str = "", *, allow_renaming: bool = False) -> Any:
    """Returns the request of SpawnEntity, 1.x or 2.x.

    Args:
        pose: initial pose, map frame.
        name: name of the entity; empty = the name in the resource.
        uri: resource of the entity.
        text: its description, in place of ``uri``.
        allow_renaming: whether the name gets a number if it exists; otherwise the request is refused.
    """
    request = SpawnEntity.Request(name=name, allow_renaming=allow_renaming)
    resource = request.entity_resource if hasattr(request, "entity_resource") else request  # 2.x, 1.x
    resource.uri, resource.resource_string = uri, text
    request.initial_pose.header.frame_id = WORLD_FRAME
    request.initial_pose.pose = pose
    return request


def move_request(name: str, pose: Pose, *, at_rest: bool = True) -> Any:
    """Returns the request of SetEntityState, 1.x or 2.x, that places an entity at a pose, map frame.

    Args:
        name: name of the entity.
        pose: the pose.
        at_rest: whether its velocity becomes 0; 1.x always sets it.
    """
    request = SetEntityState.Request(entity=name)
    request.state.header.frame_id = WORLD_FRAME
    request.state.pose = pose
    for flag in ("set_pose", *(("set_twist",) if at_rest else ())):  # 2.x
        if hasattr(request, flag):
            setattr(request, flag, True)
    return request


def state_request(state: int) -> Any:
    """Returns the request of SetSimulationState; ``state`` is a key of ``STATES``."""
    return SetSimulationState.Request(state=SimulationState(state=state))


def parameter_request(name: str, value: float) -> Any:
    """Returns the request of SetParameters that sets a parameter of type double."""
    parameter = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
    return SetParameters.Request(parameters=[Parameter(name=name, value=parameter)])


def floor_pose(at: tuple[float, float, float], floor_z: float) -> Pose:
    """Returns the pose just above a floor at x, y (m) and yaw (rad); ``floor_z`` is the height of the floor, m."""
    return flat_pose(at[0], at[1], floor_z + DROP_M, at[2])


def flat_pose(x: float, y: float, z: float, yaw: float) -> Pose:
    """Returns a pose with roll and pitch 0; m and rad."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = x, y, z
    pose.orientation.z, pose.orientation.w = math.sin(yaw / 2), math.cos(yaw / 2)
    return pose
