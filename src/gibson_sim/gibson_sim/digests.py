"""Digests of values; equal digests mean bit-equal values."""

from __future__ import annotations

import hashlib
import struct
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

STAMP_FIELD = "stamp_ns"
"""Name of fields that are excluded, so that a repeated run has the same digests."""


def digest_of(value: Any) -> int:
    """Returns the first eight bytes of BLAKE2b of a value, as an unsigned 64-bit integer.

    Arrays are hashed with type, shape and all bits, so 0.0 differs from -0.0, and one NaN from another. Dataclasses are hashed by their fields
    except ``stamp_ns``, mappings in their order; the other supported types are tuples, lists, numbers, strings, bytes and None.

    Raises:
        TypeError: the value contains another type.
    """
    digest = hashlib.blake2b(digest_size=8)
    _feed(digest, value)
    return int.from_bytes(digest.digest(), "little")


def _feed(digest: Any, value: Any) -> None:
    """Adds a value in an unambiguous encoding: values of different structure never yield the same bytes."""
    if isinstance(value, np.ndarray):
        digest.update(f"a{value.dtype.str}{value.shape}".encode())
        digest.update(np.ascontiguousarray(value).data)
    elif value is None:
        digest.update(b"n")
    elif isinstance(value, (bool, int, np.integer)):
        digest.update(b"i%d;" % int(value))
    elif isinstance(value, (float, np.floating)):
        digest.update(b"f" + struct.pack("<d", value))
    elif isinstance(value, str):
        _feed_bytes(digest, b"s", value.encode())
    elif isinstance(value, (bytes, bytearray, memoryview)):
        _feed_bytes(digest, b"b", bytes(value))
    elif isinstance(value, (tuple, list)):
        digest.update(b"t%d;" % len(value))
        for item in value:
            _feed(digest, item)
    elif isinstance(value, Mapping):
        _feed(digest, [item for pair in value.items() for item in pair])
    elif is_dataclass(value) and not isinstance(value, type):
        digest.update(b"d")
        for field in fields(value):
            if field.name != STAMP_FIELD:
                _feed(digest, getattr(value, field.name))
    else:
        raise TypeError(f"no digest of a {type(value).__name__}")


def _feed_bytes(digest: Any, kind: bytes, data: bytes) -> None:
    digest.update(b"%s%d;" % (kind, len(data)))
    digest.update(data)
