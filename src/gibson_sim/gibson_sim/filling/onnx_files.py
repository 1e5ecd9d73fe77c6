"""Opens untrusted ONNX files with onnxruntime: nothing is read but the file itself, every failure is one line."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import clipped, quoted
from gibson_sim.reading import read_file

MAX_BYTES = 256 << 20
"""Largest file that is read. LaMa, the largest inpainting network in wide use, has 208 MB; MI-GAN has 28 MB."""
THREADS = 2
"""Threads of a network. A fixed number, so that images do not depend on how many cores there are."""
INSTALL = "pip install gibson-sim[filler]"
_MAX_DEPTH = 60
"""Messages within messages: subgraphs of nodes of subgraphs."""
_CHILDREN: dict[str, dict[int, str]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
}
"""Kind of a message of onnx.proto -> number of a field -> kind of the messages in it, as far as tensors can be in them."""
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14
"""Fields of a tensor that send a reader to another file."""


def open_session(file: Path) -> Any:
    """Returns a session of onnxruntime for a file: on CUDA where onnxruntime has it, else on the CPU.

    Raises:
        ConfigError: onnxruntime is not installed, or the file holds no network that it runs, or one that reads other files.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigError(f"{file} needs onnxruntime, which is not installed: {INSTALL}") from error
    try:
        content = read_file(file, MAX_BYTES)
    except OSError as error:
        raise ConfigError(f"cannot read '{clipped(str(file), 200)}': {error.strerror or error}; give an ONNX file") from error
    try:
        external = _has_external_data(memoryview(content), "model", 0)
    except (ValueError, IndexError) as error:
        raise ConfigError(f"{file} is no ONNX file, or is cut; export it anew") from error
    if external:
        raise ConfigError(f"{file} keeps its weights in other files, which are not read; export it into one file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = THREADS, 1
    # Threads that wait would take the cores from physics and from the software renderer.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.use_deterministic_compute = True
    options.log_severity_level = 4
    providers = [
        name for name in ("CUDAExecutionProvider", "CPUExecutionProvider") if name in onnxruntime.get_available_providers()
    ]
    try:
        return onnxruntime.InferenceSession(content, options, providers=providers)
    except Exception as error:  # of types that onnxruntime does not export
        raise ConfigError(f"{file} is no network that onnxruntime runs: {_reason(error)}") from error


def run(session: Any, file: Path, feeds: dict[str, Any]) -> list[Any]:
    """Returns all outputs.

    Raises:
        ConfigError: the network cannot be run with these inputs, or returns a NaN or an infinity.
    """
    try:
        found = [np.asarray(value) for value in session.run(None, feeds)]
    except Exception as error:  # of types that onnxruntime does not export
        raise ConfigError(f"{file} cannot be run: {_reason(error)}") from error
    if not all(np.isfinite(value).all() for value in found if np.issubdtype(value.dtype, np.floating)):
        raise ConfigError(f"{file}: its output holds a NaN or an infinity; export it anew")
    return found


def _has_external_data(message: memoryview, kind: str, depth: int) -> bool:
    """Returns whether a message holds a tensor whose values are in another file.

    Raises:
        ValueError: it is no such message.
        IndexError: it is cut.
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
                raise IndexError("cut")
            if kind == "tensor" and field == _EXTERNAL_DATA:
                return True
            if field in children and _has_external_data(message[at : at + size], children[field], depth + 1):
                return True
            at += size
        elif wire in (1, 5):
            at += 8 if wire == 1 else 4
            if at > len(message):
                raise IndexError("cut")
        else:
            raise ValueError("no such wire type")
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
    return quoted(" ".join(str(error).split()) or type(error).__name__)
