"""Value types of requests that concern the whole simulation: worlds and resets; names of resources in messages."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

from gibson_sim.quoting import quoted

EPOCH_REQUESTS = ("reset_simulation", "set_simulation_state", "load_world")
"""Services that may begin a new epoch, in which steps are counted from 0."""
CHANGING_REQUESTS = (
    "set_simulation_state",
    "reset_simulation",
    "set_entity_state",
    "spawn_entity",
    "spawn_entities",
    "delete_entity",
    "load_world",
    "unload_world",
)
"""Services that change the state of the simulation, not only its timing; the journal records their requests."""
CONTROLS = (*CHANGING_REQUESTS, "step_simulation", "simulate_steps", "set_parameters", "object_joint_command")
"""Last parts of the names of all services, actions and topics that change the world or how its time passes, except commands of robots."""


class ResetScope(IntFlag):
    """Scope of a reset, as bits; 0 and 255 mean all of them."""

    TIME = 1
    STATE = 2
    SPAWNED = 4


@dataclass(frozen=True, slots=True)
class WorldInfo:
    """Description of a loaded world, with the resource of the client's request."""

    name: str
    uri: str = ""
    text: str = ""
    description: str = ""
    tags: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LoadRequest:
    """A request to load a world."""

    uri: str = ""
    text: str = ""
    """Contents of the world file; used where ``uri`` is empty."""
    fail_on_unsupported: bool = False
    ignore_missing: bool = False


@dataclass(frozen=True, slots=True)
class LastReset:
    """The reset that began the newest epoch."""

    scope: int = 0
    """Bits of ``ResetScope``."""
    rewound: bool = False
    """Whether time restarted at 0."""


def resource_name(uri: str) -> str:
    """Returns the name in messages of the resource of a request; ``uri``: that of the request, empty if it holds the resource as text."""
    return quoted(uri) if uri.strip() else "resource_string"
