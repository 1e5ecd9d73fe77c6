"""The standard services of a simulation as methods that return the requested data, or raise an error that a user can act on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from simulation_interfaces.srv import SetSimulationState

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import quoted
from gibson_sim.ros.client.requests import OK, SERVICES, move_request, spawn_request, state_request
from gibson_sim.settings import nearest

__tracebackhide__ = True
"""pytest shows the line of the test, not those of this module; ``--full-trace`` shows all."""
Call = Callable[[str, Any, Any], Any]
"""(service name, service type, request) -> response; blocks."""


class StandardServices:
    """Calls the services by ``call``; a refused request raises a GibsonSimError with the reason and the nearest known name."""

    def __init__(self, call: Call) -> None:
        self._call = call

    def ask(self, service: str, **fields: Any) -> Any:
        """Returns the response of a service to a request with these fields.

        Raises:
            GibsonSimError: the request is refused.
        """
        return self.send(service, SERVICES[service].Request(**fields))

    def send(self, service: str, request: Any) -> Any:
        """Returns the response of a service to a request; see ``ask``."""
        return _checked(service, self._call(service, SERVICES[service], request))

    def spawn(self, uri: str, at: tuple[float, float, float], floor_z: float, name: str = "") -> str:
        """Spawns an entity on the floor, see ``requests.spawn_request``; returns its name."""
        response = self._call("spawn_entity", SERVICES["spawn_entity"], spawn_request(uri, at, floor_z, name))
        if response.result.result != OK:
            known = [spawnable.uri for spawnable in self.ask("get_spawnables").spawnables]
            raise _refusal("spawn_entity", response, uri, known)
        return str(response.entity_name)

    def move(self, name: str, at: tuple[float, float, float], floor_z: float) -> None:
        """Moves an entity to another place on the floor, at rest, see ``requests.move_request``."""
        self._call_for_entity("set_entity_state", name, move_request(name, at, floor_z))

    def delete(self, name: str) -> None:
        """Removes an entity."""
        self._call_for_entity("delete_entity", name, SERVICES["delete_entity"].Request(entity=name))

    def pose(self, name: str) -> Any:
        """Returns the geometry_msgs/Pose of an entity in the world frame."""
        return self._call_for_entity("get_entity_state", name, SERVICES["get_entity_state"].Request(entity=name)).state.pose

    def entities(self) -> tuple[str, ...]:
        """Returns the names of all entities."""
        return tuple(self.ask("get_entities").entities)

    def poses(self) -> Mapping[str, Any]:
        """Returns the geometry_msgs/Pose of each entity in the world frame."""
        response = self.ask("get_entities_states")
        return {name: state.pose for name, state in zip(response.entities, response.states, strict=True)}

    def set_state(self, state: int) -> bool:
        """Sets the state, a key of ``requests.STATES``; returns whether the state has changed."""
        response = self._call("set_simulation_state", SERVICES["set_simulation_state"], state_request(state))
        if response.result.result == SetSimulationState.Response.ALREADY_IN_TARGET_STATE:
            return False
        _checked("set_simulation_state", response)
        return True

    def _call_for_entity(self, service: str, name: str, request: Any) -> Any:
        response = self._call(service, SERVICES[service], request)
        if response.result.result != OK:
            raise _refusal(service, response, name, self.entities())
        return response


def _checked(service: str, response: Any) -> Any:
    if response.result.result != OK:
        raise _refusal(service, response)
    return response


def _refusal(service: str, response: Any, name: str = "", known: Any = ()) -> GibsonSimError:
    text = response.result.error_message or f"{service} failed with code {response.result.result}" + (
        f" for {quoted(name)}" if name else ""
    )
    hint = nearest(name, known) if name and name not in known and "did you mean" not in text else ""
    return GibsonSimError(text + (f"; {hint}" if hint else ""))
