"""Messages as bytes that end where the message ends.

``serialize_message`` of rmw_fastrtps reckons four bytes too many for each empty sequence of 64-bit numbers and leaves them at the end. ROS does not
mind; `rosbags`, which reads strictly, takes such a message for damaged.
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
"""Bytes before the message itself."""


def exact_bytes(message: Any) -> bytes:
    """Returns the message as CDR, without bytes behind its end. For messages that come seldom: it reads what it wrote."""
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
