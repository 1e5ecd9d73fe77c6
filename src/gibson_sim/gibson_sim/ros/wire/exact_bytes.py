"""Serialises messages without trailing padding.

``serialize_message`` of rmw_fastrtps reserves four bytes too many for each empty sequence of 64-bit numbers, and leaves them at the end. ROS
ignores them, but `rosbags`, a strict reader, rejects such a message as damaged.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from rclpy.serialization import serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from gibson_sim.bags.definitions import MessageDefinitions
from gibson_sim.ros.wire.message_types import type_name_of

_ENCAPSULATION = 4
"""Length of the CDR encapsulation header, bytes."""


def exact_bytes(message: Any) -> bytes:
    """Returns the message as CDR without trailing padding; slow, since it parses its own output."""
    data = bytes(serialize_message(message))
    name = type_name_of(type(message))
    store = _store(name)
    definition = store.get_msgdef(name)
    _, end = definition.deserialize_cdr_le(data[_ENCAPSULATION:], 0, definition.cls, store)
    return data[: _ENCAPSULATION + int(end)]


@lru_cache
def _store(name: str) -> Typestore:
    store = get_typestore(Stores.EMPTY)
    store.register(get_types_from_msg(MessageDefinitions().full_text(name), name))
    return store
