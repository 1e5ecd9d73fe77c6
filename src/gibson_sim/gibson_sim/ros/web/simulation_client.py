"""Requests of a page to a simulation, through the services of ``simulation_interfaces``, of any simulator that offers them."""

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
"""Time without a response after which a page gets a notice, and after which the call is dropped, s of wall time."""


@dataclass(slots=True)
class _Call:
    """A pending service call."""

    client: Any
    future: Any
    start_s: float
    on_late: Callable[[str], None] | None
    """Called once with a text for the page if the response is late; None = no notice."""


class SimulationClient:
    """Calls the services without blocking."""

    def __init__(self, node: Node, physics: str = "physics") -> None:
        """Creates the service clients; ``physics`` is the name of the node with the parameter ``rate``."""
        self._node, self._clients = node, {name: node.create_client(kind, name) for name, kind in SERVICES.items()}
        self._parameters = node.create_client(SetParameters, f"{physics}/set_parameters")
        self._parameter_reader = node.create_client(GetParameters, f"{physics}/get_parameters")
        self._calls: list[_Call] = []

    def is_available(self) -> bool:
        """Returns whether a simulation offers its services in this domain."""
        return bool(self._clients["get_simulation_state"].service_is_ready())

    def ask(self, request: Request, answer: Answer) -> None:
        """Executes a request of a page; ``answer`` is called once it is done.

        Args:
            request: request of a page.
            answer: called with (whether the request succeeded, text for the page).
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
            message = spawn_request(request.uri, (request.x, request.y, request.yaw), request.z)
            self._do("spawn_entity", message, answer, "spawned {response.entity_name}")
        elif isinstance(request, Move):
            message = move_request(request.name, (request.x, request.y, request.yaw), request.z)
            self._do("set_entity_state", message, answer, "moved " + _literal(request.name))
        elif isinstance(request, Delete):
            self._do("delete_entity", DeleteEntity.Request(entity=request.name), answer, "deleted " + _literal(request.name))

    def get(self, service: str, request: Any, on_response: Callable[[Any], None]) -> None:
        """Calls a service, and ``on_response`` if it succeeds; does nothing while a previous such call is pending."""
        client = self._clients[service]
        if not any(call.client is client and call.on_late is None for call in self._calls):
            self._call(
                client,
                request,
                lambda response: on_response(response) if response and response.result.result == OK else None,
            )

    def get_rate(self, on_rate: Callable[[float], None]) -> None:
        """Calls ``on_rate`` with the present setting ``rate`` of simulation time; 0 = as fast as possible."""

        def on_values(response: Any) -> None:
            values = response.values if response is not None else ()
            if values and values[0].type == ParameterType.PARAMETER_DOUBLE:
                on_rate(float(values[0].double_value))

        if not any(call.client is self._parameter_reader for call in self._calls):
            self._call(self._parameter_reader, GetParameters.Request(names=["rate"]), on_values)

    def call(self, client: Any, request: Any, on_response: Callable[[Any], None], answer: Answer) -> None:
        """Calls any service; ``on_response`` gets its response, or None if no node offers it; ``answer`` reports a late response."""
        self._call(client, request, on_response, partial(answer, False))

    def check_pending(self) -> None:
        """Reports late calls to pages, and drops calls that have timed out."""
        now = time.monotonic()
        for call in list(self._calls):
            if call.on_late is not None and now - call.start_s > LATE_S:
                call.on_late(
                    f"{call.client.srv_name.lstrip('/')} has not answered for {LATE_S:.0f} s: its node may be busy, or hang"
                )
                call.on_late = _ignore
            if now - call.start_s > LOST_S:
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

    def _do(self, service: str, request: Any, answer: Answer, success_text: str) -> None:
        # Codes above 100 are specific to a service: 101 of spawn_entity means that the name is not unique.
        success_codes = {OK, SetSimulationState.Response.ALREADY_IN_TARGET_STATE} if service == "set_simulation_state" else {OK}

        def on_response(response: Any) -> None:
            if response is None:
                answer(False, f"no node offers the service {service}: does a simulation run in this ROS domain?")
            elif response.result.result not in success_codes:
                answer(False, response.result.error_message or f"{service} failed with code {response.result.result}")
            else:
                answer(True, success_text.format(response=response))

        self._call(self._clients[service], request, on_response, partial(answer, False))

    def _call(
        self, client: Any, request: Any, on_response: Callable[[Any], None], on_late: Callable[[str], None] | None = None
    ) -> None:
        if not client.service_is_ready():
            on_response(None)
            return
        call = _Call(client, client.call_async(request), time.monotonic(), on_late)
        self._calls.append(call)

        def on_done(future: Any) -> None:
            if call in self._calls:
                self._calls.remove(call)
                on_response(None if future.exception() else future.result())

        call.future.add_done_callback(on_done)


def _ignore(text: str) -> None:
    """Does nothing: a page gets one notice only."""


def _literal(text: str) -> str:
    """Returns a text that ``str.format`` leaves unchanged."""
    return text.replace("{", "{{").replace("}", "}}")


def _parameter(answer: Answer, response: Any) -> None:
    results = response.results if response is not None else ()
    if not results:
        answer(False, "no node has the parameter rate: does a simulation run in this ROS domain?")
    else:
        answer(bool(results[0].successful), results[0].reason)
