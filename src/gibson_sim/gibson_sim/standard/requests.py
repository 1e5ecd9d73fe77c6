"""Values of requests about the simulation as a whole: worlds and resets."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

EPOCH_REQUESTS = ("reset_simulation", "set_simulation_state", "load_world")
"""Services that may begin a new epoch, in which steps count from 0."""


class ResetScope(IntFlag):
    """Parts of a reset; 0 and 255 mean all of them."""

    TIME = 1
    STATE = 2
    SPAWNED = 4


@dataclass(frozen=True, slots=True)
class WorldInfo:
    """Description of a world, with the resource of the client's request."""

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
    """The file itself; used where ``uri`` is empty."""
    fail_on_unsupported: bool = False
    ignore_missing: bool = False


@dataclass(frozen=True, slots=True)
class LastReset:
    """How the newest epoch began."""

    scope: int = 0
    """Bits of ``ResetScope``."""
    rewound: bool = False
    """Time restarted at 0."""
