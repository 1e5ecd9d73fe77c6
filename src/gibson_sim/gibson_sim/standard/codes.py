"""Result codes of the standard, common to all services (0 to 4) and specific to one (above 100), and the error that carries one.

https://github.com/ros-simulation/simulation_interfaces; versions 1.x and 2.x have the same codes.
"""

from __future__ import annotations

import logging
from enum import IntEnum

from gibson_sim.errors import GibsonSimError
from gibson_sim.quoting import clipped

_log = logging.getLogger(__name__)
MAX_LOGGED_LENGTH = 4000
"""Maximum length of a message in the log, characters."""
MAX_MESSAGE_LENGTH = 600
"""Maximum length of a message to a client, characters: a name of megabytes is not echoed."""


class Result(IntEnum):
    """Codes common to all services."""

    FEATURE_UNSUPPORTED = 0
    OK = 1
    NOT_FOUND = 2
    INCORRECT_STATE = 3
    OPERATION_FAILED = 4


class StateCode(IntEnum):
    """Codes of SetSimulationState."""

    ALREADY_IN_TARGET_STATE = 101
    STATE_TRANSITION_ERROR = 102
    INCORRECT_TRANSITION = 103


class SpawnCode(IntEnum):
    """Codes of SpawnEntity and of each item of SpawnEntities."""

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
    """Codes of SpawnEntities as a whole."""

    ENTITIES_SPAWN_FAILED = 150


class EntityStateCode(IntEnum):
    """Codes of SetEntityState."""

    INVALID_POSE = 101


class WorldsCode(IntEnum):
    """Codes of GetAvailableWorlds."""

    DEFAULT_SOURCES_FAILED = 101


class WorldCode(IntEnum):
    """Codes of GetCurrentWorld and UnloadWorld."""

    NO_WORLD_LOADED = 101


class LoadWorldCode(IntEnum):
    """Codes of LoadWorld."""

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


def client_message(resource: str, error: GibsonSimError) -> str:
    """Returns the error message to a client for an unusable resource, without any of the file's contents.

    The whole error goes to the log: users who may read the log may read the file.
    """
    reason = error.public or "cannot be used"
    _log.warning("%s cannot be used: %s", resource, clipped(str(error), MAX_LOGGED_LENGTH))
    return f"{resource}: {reason}; see the log of the simulation"


def shortened(text: str) -> str:
    """Returns the text on one line; the middle of a long text is omitted."""
    return clipped(text, MAX_MESSAGE_LENGTH)
