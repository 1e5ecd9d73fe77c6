"""The numbers of the standard: result codes, general (0 to 4) and of single services (above 100), and the error that carries one.

https://github.com/ros-simulation/simulation_interfaces, versions 1.x and 2.x, which do not differ here.
"""

from __future__ import annotations

import logging
from enum import IntEnum

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import clipped

_log = logging.getLogger(__name__)
LONGEST_LOGGED = 4000
"""Characters of a message in the log."""
LONGEST_MESSAGE = 600
"""Characters; a client that sends megabytes does not get them back."""


class Result(IntEnum):
    """Codes of every service."""

    FEATURE_UNSUPPORTED = 0
    OK = 1
    NOT_FOUND = 2
    INCORRECT_STATE = 3
    OPERATION_FAILED = 4


class StateCode(IntEnum):
    """SetSimulationState."""

    ALREADY_IN_TARGET_STATE = 101
    STATE_TRANSITION_ERROR = 102
    INCORRECT_TRANSITION = 103


class SpawnCode(IntEnum):
    """SpawnEntity, and each item of SpawnEntities."""

    NAME_NOT_UNIQUE = 101
    NAME_INVALID = 102
    UNSUPPORTED_FORMAT = 103
    NO_RESOURCE = 104
    NAMESPACE_INVALID = 105
    RESOURCE_PARSE_ERROR = 106
    MISSING_ASSETS = 107
    UNSUPPORTED_ASSETS = 108
    INVALID_POSE = 109


class SpawnEntitiesCode(IntEnum):
    """SpawnEntities as a whole."""

    ENTITIES_SPAWN_FAILED = 150


class EntityStateCode(IntEnum):
    """SetEntityState."""

    INVALID_POSE = 101


class WorldsCode(IntEnum):
    """GetAvailableWorlds."""

    DEFAULT_SOURCES_FAILED = 101


class WorldCode(IntEnum):
    """GetCurrentWorld and UnloadWorld."""

    NO_WORLD_LOADED = 101


class LoadWorldCode(IntEnum):
    """LoadWorld."""

    UNSUPPORTED_FORMAT = 101
    NO_RESOURCE = 102
    RESOURCE_PARSE_ERROR = 103
    MISSING_ASSETS = 104
    UNSUPPORTED_ASSETS = 105
    UNSUPPORTED_ELEMENTS = 106


class SimulationError(GibsonSimError):
    """A request that cannot be fulfilled: its code in the standard and one line of text."""

    def __init__(self, code: IntEnum, message: str) -> None:
        super().__init__(shortened(message))
        self.code = code


def told(what: str, error: GibsonSimError) -> str:
    """Returns what a client may be told of a file that it named and that cannot be used: nothing of what stands in it.

    The log has the whole of it: whoever may read that may read the file.
    """
    reason = error.public or "cannot be used"
    _log.warning("%s cannot be used: %s", what, clipped(str(error), LONGEST_LOGGED))
    return f"{what}: {reason}; the log of the simulation says more"


def shortened(text: str) -> str:
    """Returns the text on one line, its middle left out where it is too long."""
    return clipped(text, LONGEST_MESSAGE)
