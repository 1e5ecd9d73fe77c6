"""Opens untrusted ONNX files with onnxruntime: reads only the file itself; each error is one line."""

from __future__ import annotations

import os
import re
import stat
from pathlib import Path
from typing import Any

import numpy as np

from gibson_path_following.errors import ModelError

MAX_BYTES = 1 << 30
"""Maximum size of a file, bytes; those of the GNM family have 35 to 111 MB."""
_MAX_DEPTH = 60
"""Maximum nesting depth of messages (subgraphs of nodes of subgraphs)."""
_CHILDREN: dict[str, dict[int, str]] = {
    "model": {7: "graph", 25: "function"},
    "function": {7: "node"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
}
"""Kind of a message of onnx.proto -> field number -> kind of the messages in it, for those that can contain tensors."""
_LONGEST_REASON = 240
"""Maximum length of a message of onnxruntime, characters."""
_CODE = re.compile(r"^\[ONNXRuntimeError\] : \d+ : \w+ : ")
_SOURCE = re.compile(r"/onnxruntime_src/\S+:\d+ .*?\) (?=[A-Z])")
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14
"""Field numbers of a tensor that refer to external data."""


def open_session(file: Path) -> Any:
    """Returns an onnxruntime session for a file, on one core of the CPU.

    Raises:
        ModelError: onnxruntime is not installed, cannot load the file, or its weights are in other files.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise ModelError(
            f"{file} needs onnxruntime, which is not installed: pip install 'gibson_path_following[onnx]'"
        ) from error
    content = _content(file)
    if not content.strip(b"\0"):
        raise ModelError(f"{file} is empty, or holds only zeros; export it again")
    try:
        external = _has_external_data(memoryview(content), "model", 0)
    except (ValueError, IndexError) as error:
        raise ModelError(f"{file} is not an ONNX file, or is truncated; export it again") from error
    if external:
        raise ModelError(f"{file} has its weights in other files, which are not read; export it as one file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        return onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime does not export their types
        raise ModelError(
            f"{file} cannot be loaded by onnxruntime: {_reason(error)}; export it again, or update onnxruntime"
        ) from error


def run(session: Any, file: Path, feeds: dict[str, Any]) -> list[Any]:
    """Returns all outputs of a network.

    Raises:
        ModelError: the network cannot be run with these inputs, or returns something else than finite numbers.
    """
    try:
        found = list(session.run(None, feeds))
    except Exception as error:  # onnxruntime does not export their types
        raise ModelError(f"{file} cannot be run: {_reason(error)}") from error
    if not all(isinstance(value, np.ndarray) and value.dtype.kind in "biuf" for value in found):
        raise ModelError(f"{file}: an output holds texts, maps or sequences, must be an array of numbers; export it again")
    if not all(np.isfinite(value).all() for value in found):
        raise ModelError(f"{file}: its output holds a NaN or an infinity; export it again")
    return found


def _content(file: Path) -> bytes:
    try:
        descriptor = os.open(file, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe must not block
        with open(descriptor, "rb") as opened:
            status = os.fstat(descriptor)
            if not stat.S_ISREG(status.st_mode):
                raise ModelError(f"{file} is not a regular file; give an ONNX file")
            if status.st_size > MAX_BYTES:
                raise ModelError(f"{file} has {status.st_size / 2**20:.0f} MB, at most {MAX_BYTES >> 20} are read")
            return opened.read(MAX_BYTES)
    except (OSError, ValueError) as error:
        reason = (error.strerror if isinstance(error, OSError) else None) or str(error)
        raise ModelError(f"cannot read {file}: {reason}; give an ONNX file") from error


def _has_external_data(message: memoryview, kind: str, depth: int) -> bool:
    """Returns whether a message contains a tensor with external data.

    Raises:
        ValueError: the message is invalid.
        IndexError: the message is truncated.
    """
    if depth > _MAX_DEPTH:
        raise ValueError("too deep")
    children = _CHILDREN.get(kind, {})
    at = 0
    while at < len(message):
        tag, at = _varint(message, at)
        field, wire = tag >> 3, tag & 7
        if wire == 0:
            value, at = _varint(message, at)
            if kind == "tensor" and field == _DATA_LOCATION and value:
                return True
        elif wire == 2:
            size, at = _varint(message, at)
            if at + size > len(message):
                raise IndexError("truncated")
            if kind == "tensor" and field == _EXTERNAL_DATA:
                return True
            if field in children and _has_external_data(message[at : at + size], children[field], depth + 1):
                return True
            at += size
        elif wire in (1, 5):
            at += 8 if wire == 1 else 4
            if at > len(message):
                raise IndexError("truncated")
        else:
            raise ValueError("unknown wire type")
    return False


def _varint(message: memoryview, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        at += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value, at
        shift += 7
        if shift > 63:
            raise ValueError("number too long")


def _reason(error: Exception) -> str:
    """Returns the message of onnxruntime without its error code and the C++ function that raised it, shortened in the middle."""
    text = _SOURCE.sub("", _CODE.sub("", " ".join(str(error).split()))) or type(error).__name__
    half = _LONGEST_REASON // 2
    line = text if len(text) <= _LONGEST_REASON else f"{text[:half]} ... {text[-half:]}"
    return "".join(c if c.isprintable() else repr(c)[1:-1] for c in line).rstrip(".")
