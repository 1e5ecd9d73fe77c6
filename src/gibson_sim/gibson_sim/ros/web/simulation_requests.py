"""Requests of a page to a simulation: each is a call of one of its services."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, SetParameters
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import DeleteEntity, ResetSimulation, StepSimulation

from gibson_sim.ros.client.simulation_client import (
    SimulationClient,
    floor_pose,
    is_success,
    move_request,
    parameter_request,
    refusal_text,
    spawn_request,
    state_request,
)
from gibson_sim.web.pages import Answer
from gibson_sim.web.requests import Delete, Move, Rate, Request, Spawn, Time

_RATE, _SET, _GET = "rate", "physics/set_parameters", "physics/get_parameters"


class SimulationRequests:
    """Executes requests of pages without blocking.

    Args:
        services: client of the simulation.
    """

    def __init__(self, services: SimulationClient) -> None:
        self._services = services
        for service in (
            "delete_entity", "get_entities_states", "get_named_poses", "get_simulation_state", "get_spawnables", "reset_simulation",
            "set_entity_state", "set_simulation_state", "spawn_entity", "step_simulation",
        ):  # fmt: skip
            services.prepare(service)
        services.prepare(_SET, SetParameters)
        services.prepare(_GET, GetParameters)

    def ask(self, request: Request, answer: Answer) -> None:
        """Executes a request of a page; ``answer`` is called once it is done.

        Args:
            request: request of a page.
            answer: called with (whether the request succeeded, text for the page).
        """
        if isinstance(request, Time):
            self._time(request, answer)
        elif isinstance(request, Rate):
            self._services.begin(
                _SET, parameter_request(_RATE, request.value), partial(_rate_set, answer), partial(answer, False)
            )
        elif isinstance(request, Spawn):
            pose = floor_pose((request.x, request.y, request.yaw), request.z)
            message = spawn_request(pose, uri=request.uri, allow_renaming=True)
            self._do("spawn_entity", message, answer, "spawned {response.entity_name}")
        elif isinstance(request, Move):
            message = move_request(request.name, floor_pose((request.x, request.y, request.yaw), request.z))
            self._do("set_entity_state", message, answer, "moved " + _literal(request.name))
        elif isinstance(request, Delete):
            self._do("delete_entity", DeleteEntity.Request(entity=request.name), answer, "deleted " + _literal(request.name))

    def get(self, service: str, request: Any, on_response: Callable[[Any], None]) -> None:
        """Calls a service, and ``on_response`` if it succeeds; does nothing while a previous call is pending."""
        if not self._services.is_pending(service):
            self._services.begin(
                service, request, lambda response: on_response(response) if response and is_success(service, response) else None
            )

    def get_rate(self, on_rate: Callable[[float], None]) -> None:
        """Calls ``on_rate`` with the present setting ``rate`` of simulation time; 0 = as fast as possible."""

        def on_values(response: Any) -> None:
            values = response.values if response is not None else ()
            if values and values[0].type == ParameterType.PARAMETER_DOUBLE:
                on_rate(float(values[0].double_value))

        if not self._services.is_pending(_GET):
            self._services.begin(_GET, GetParameters.Request(names=[_RATE]), on_values)

    def _time(self, request: Time, answer: Answer) -> None:
        if request.action == "step":
            self._do("step_simulation", StepSimulation.Request(steps=request.steps), answer, "")
        elif request.action == "reset":
            self._do("reset_simulation", ResetSimulation.Request(), answer, "the simulation was reset")
        else:
            state = SimulationState.STATE_PLAYING if request.action == "play" else SimulationState.STATE_PAUSED
            self._do("set_simulation_state", state_request(state), answer, "")

    def _do(self, service: str, request: Any, answer: Answer, success_text: str) -> None:
        def on_response(response: Any) -> None:
            if response is None:
                answer(False, f"no node offers the service {service}: does a simulation run in this ROS domain?")
            elif not is_success(service, response):
                answer(False, refusal_text(service, response))
            else:
                answer(True, success_text.format(response=response))

        self._services.begin(service, request, on_response, partial(answer, False))


def _literal(text: str) -> str:
    """Returns a text that ``str.format`` leaves unchanged."""
    return text.replace("{", "{{").replace("}", "}}")


def _rate_set(answer: Answer, response: Any) -> None:
    results = response.results if response is not None else ()
    if not results:
        answer(False, "no node has the parameter rate: does a simulation run in this ROS domain?")
    else:
        answer(bool(results[0].successful), results[0].reason)
