"""Writes small ONNX files without the onnx package: the few messages of onnx.proto that a graph of known operators needs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

TYPES = {"float32": 1, "uint8": 2, "int64": 7, "string": 8}
"""Numbers of element types."""


def number(field: int, value: int) -> bytes:
    return _varint(field << 3) + _varint(value)


def message(field: int, content: bytes | str) -> bytes:
    data = content.encode() if isinstance(content, str) else content
    return _varint(field << 3 | 2) + _varint(len(data)) + data


def tensor(name: str, values: Any) -> bytes:
    array = np.asarray(values)
    dims = b"".join(number(1, size) for size in array.shape)
    return dims + number(2, TYPES[array.dtype.name]) + message(8, name) + message(9, array.tobytes())


def external_tensor(name: str, shape: Sequence[int], file: str) -> bytes:
    """Returns a tensor whose values are said to be in another file."""
    dims = b"".join(number(1, size) for size in shape)
    entry = message(1, "location") + message(2, file)
    return dims + number(2, 1) + message(8, name) + message(13, entry) + number(14, 1)


def node(operator: str, inputs: Sequence[str], output: str, **attributes: int | Sequence[int]) -> bytes:
    """Returns a node; attributes are whole numbers or lists of them."""
    found = b"".join(message(1, name) for name in inputs) + message(2, output) + message(4, operator)
    for name, value in attributes.items():
        if isinstance(value, int):
            found += message(5, message(1, name) + number(3, value) + number(20, 2))
        else:
            found += message(5, message(1, name) + b"".join(number(8, item) for item in value) + number(20, 7))
    return found


def value(name: str, kind: str, shape: Sequence[int | str]) -> bytes:
    """Returns what an input or output is; a size that is text is free."""
    dims = b"".join(message(1, number(1, size) if isinstance(size, int) else message(2, size)) for size in shape)
    return message(1, name) + message(2, message(1, number(1, TYPES[kind]) + message(2, dims)))


def model(
    nodes: Sequence[bytes], inputs: Sequence[bytes], outputs: Sequence[bytes], tensors: Mapping[str, Any] | Sequence[bytes] = ()
) -> bytes:
    """Returns a file of opset 13."""
    initial = [tensor(name, values) for name, values in tensors.items()] if isinstance(tensors, Mapping) else list(tensors)
    graph = b"".join(message(1, content) for content in nodes) + message(2, "small")
    graph += b"".join(message(5, content) for content in initial)
    graph += b"".join(message(11, content) for content in inputs) + b"".join(message(12, content) for content in outputs)
    return number(1, 8) + message(7, graph) + message(8, message(1, "") + number(2, 13))


def _varint(value: int) -> bytes:
    found = bytearray()
    while value >= 0x80:
        found.append(value & 0x7F | 0x80)
        value >>= 7
    found.append(value)
    return bytes(found)
