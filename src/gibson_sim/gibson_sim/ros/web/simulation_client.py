"""What a page asks of a simulation, by the services of ``simulation_interfaces``: any simulator that has them will do."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.node import Node
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import DeleteEntity, ResetSimulation, SetSimulationState, StepSimulation

from gibson_sim.ros.client.requests import OK, SERVICES, move_request, spawn_request, state_request
from gibson_sim.web.pages import Answer
from gibson_sim.web.requests import Delete, Move, Rate, Request, Spawn, Time

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
        self._node, self._clients = node, {name: node.create_client(kind, name) for name, kind in SERVICES.items()}
        self._parameters = node.create_client(SetParameters, f"{physics}/set_parameters")
        self._parameter_reader = node.create_client(GetParameters, f"{physics}/get_parameters")
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
            self._call(client, request, lambda response: then(response) if response and response.result.result == OK else None)

    def get_rate(self, then: Callable[[float], None]) -> None:
        """Calls ``then`` with the rate of simulation time that is requested, whoever has set it; 0 = as fast as it can."""

        def told(response: Any) -> None:
            values = response.values if response is not None else ()
            if values and values[0].type == ParameterType.PARAMETER_DOUBLE:
                then(float(values[0].double_value))

        if not any(call.client is self._parameter_reader for call in self._calls):
            self._call(self._parameter_reader, GetParameters.Request(names=["rate"]), told)

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
            self._do("set_simulation_state", state_request(state), answer, "")

    def _do(self, service: str, request: Any, answer: Answer, done: str) -> None:
        # Each service has codes of its own above 100: 101 is a taken name for spawn_entity.
        good = {OK, SetSimulationState.Response.ALREADY_IN_TARGET_STATE} if service == "set_simulation_state" else {OK}

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
