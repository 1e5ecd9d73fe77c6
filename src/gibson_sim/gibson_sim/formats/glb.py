"""The container of binary glTF files: "GLB File Format Specification" in glTF 2.0, https://registry.khronos.org/glTF/specs/2.0/glTF-2.0.html."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

_MAGIC, _VERSION = 0x46546C67, 2
_JSON, _BIN = 0x4E4F534A, 0x004E4942
_ALIGNMENT = 4


def glb_bytes(document: Mapping[str, Any], binary: bytes | bytearray) -> bytes:
    """Returns a GLB file.

    Args:
        document: the glTF, whose first buffer, if it has any, is ``binary`` and has no ``uri``.
        binary: that buffer; empty = the file has no chunk for it.
    """
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = _chunk(_JSON, text, b" ") + (_chunk(_BIN, binary, b"\0") if binary else b"")
    return struct.pack("<III", _MAGIC, _VERSION, 12 + len(chunks)) + chunks


def _chunk(kind: int, data: bytes | bytearray, padding: bytes) -> bytes:
    """Returns a chunk with its head; its length is a multiple of 4 and counts the padding."""
    padded = data + padding * (-len(data) % _ALIGNMENT)
    return struct.pack("<II", len(padded), kind) + padded
