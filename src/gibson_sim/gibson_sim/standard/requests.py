"""What clients ask of the simulation as a whole, and what it says of itself."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntFlag

EPOCH_REQUESTS = ("reset_simulation", "set_simulation_state", "load_world")
"""Services after which steps may count anew."""


class ResetScope(IntFlag):
    """What a reset is about; 0 and 255 mean all of it."""

    TIME = 1
    STATE = 2
    SPAWNED = 4


@dataclass(frozen=True, slots=True)
class WorldInfo:
    """What is known of a world; the resource as the client gave it."""

    name: str
    uri: str = ""
    text: str = ""
    description: str = ""
    tags: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LoadRequest:
    """What a client wants to load."""

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
    """Time began at 0 again."""
