"""Opens untrusted ONNX files with onnxruntime: reads only the file itself; each error is one line."""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import clipped
from gibson_sim.reading import read_file

_log = logging.getLogger(__name__)
MAX_BYTES = 256 << 20
"""Maximum size of a file, bytes. LaMa, the largest inpainting network in wide use, has 208 MB; MI-GAN has 28 MB."""
THREADS = 2
"""Number of threads of a network; fixed, so that images do not depend on the number of cores."""
INSTALL = "pip install 'gibson_sim[filler]'"
_MAX_DEPTH = 60
"""Maximum nesting depth of messages (subgraphs of nodes of subgraphs)."""
_CHILDREN: dict[str, dict[int, str]] = {
    "model": {7: "graph", 20: "training", 25: "function"},
    "training": {1: "graph", 2: "graph"},
    "function": {7: "node"},
    "graph": {1: "node", 5: "tensor", 15: "sparse"},
    "node": {5: "attribute"},
    "attribute": {5: "tensor", 6: "graph", 10: "tensor", 11: "graph", 22: "sparse", 23: "sparse"},
    "sparse": {1: "tensor", 2: "tensor"},
}
"""Kind of a message in onnx.proto -> field number -> kind of the nested message; only those that can contain tensors."""
_LONGEST_REASON = 240
"""Maximum length of a message of onnxruntime, characters."""
_CODE = re.compile(r"^\[ONNXRuntimeError\] : \d+ : \w+ : ")
_SOURCE = re.compile(r"/onnxruntime_src/\S+:\d+ .*?\) (?=[A-Z])")
_CUDA = "CUDAExecutionProvider"
_CUDA_OPTIONS = {"cudnn_conv_algo_search": "HEURISTIC", "use_tf32": "0"}
"""The default search takes times, so that algorithms, and with them bits, could differ from run to run."""
_EXTERNAL_DATA, _DATA_LOCATION = 13, 14
"""Fields of a tensor that refer to another file."""


def open_session(file: Path, cuda_device: int = 0) -> Any:
    """Returns an onnxruntime session for a file: on CUDA if onnxruntime supports it, else on the CPU.

    Args:
        file: an ONNX file.
        cuda_device: CUDA device ordinal.

    Raises:
        ConfigError: onnxruntime is not installed or cannot load the file, or its weights are in other files.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise ConfigError(f"{file} needs onnxruntime, which is not installed: {INSTALL}") from error
    try:
        content = read_file(file, MAX_BYTES)
    except OSError as error:
        raise ConfigError(f"cannot read '{clipped(str(file), 200)}': {error.strerror or error}; give an ONNX file") from error
    if not content.strip(b"\0"):
        raise ConfigError(f"{file} is empty, or holds only zeros; export it again")
    try:
        external = _has_external_data(memoryview(content), "model", 0)
    except (ValueError, IndexError) as error:
        raise ConfigError(f"{file} is not an ONNX file, or is truncated; export it again") from error
    if external:
        raise ConfigError(f"{file} has its weights in other files, which are not read; export it as one file")
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads, options.inter_op_num_threads = THREADS, 1
    # Spinning threads would take cores from physics and the software renderer.
    options.add_session_config_entry("session.intra_op.allow_spinning", "0")
    options.use_deterministic_compute = True
    options.log_severity_level = 4
    providers: list[Any] = ["CPUExecutionProvider"]
    if _CUDA in onnxruntime.get_available_providers():
        if hasattr(onnxruntime, "preload_dlls"):  # CUDA and cuDNN of PyPI; it prints what it does not find
            with redirect_stdout(StringIO()) as printed:
                onnxruntime.preload_dlls()
            _log.info("%s", printed.getvalue())
        providers.insert(0, (_CUDA, {"device_id": str(cuda_device), **_CUDA_OPTIONS}))
    try:
        return onnxruntime.InferenceSession(content, options, providers=providers)
    except Exception as error:  # onnxruntime does not export their types
        raise ConfigError(f"onnxruntime cannot load {file}: {_reason(error)}; export it again, or update onnxruntime") from error


@dataclass(frozen=True, slots=True)
class DeviceTensor:
    """A float32 tensor in the memory of a device."""

    name: str
    """Name of an input or output of a network."""
    shape: tuple[int, ...]
    address: int


def device_of(session: Any) -> str:
    """Returns the kind of device that a network runs on, in the notation of onnxruntime: ``cuda`` or ``cpu``."""
    return "cuda" if session.get_providers()[0] == _CUDA else "cpu"


def run_on_device(
    session: Any, file: Path, ordinal: int, inputs: Sequence[DeviceTensor], outputs: Sequence[DeviceTensor]
) -> None:
    """Runs a network on memory of its own device, without a copy; returns when all its work has ended.

    Args:
        session: session of ``open_session``.
        file: its file.
        ordinal: ordinal of the device with the tensors.
        inputs: all inputs, already complete.
        outputs: outputs to write; their shapes must be those that the network returns.

    Raises:
        ConfigError: the network cannot be run with these inputs and outputs.
    """
    device = device_of(session)
    try:
        binding = session.io_binding()
        for bind, tensors in ((binding.bind_input, inputs), (binding.bind_output, outputs)):
            for tensor in tensors:
                bind(tensor.name, device, ordinal, np.float32, tensor.shape, tensor.address)
        session.run_with_iobinding(binding)
        binding.synchronize_outputs()
    except Exception as error:  # onnxruntime does not export their types
        raise ConfigError(f"{file} cannot be run: {_reason(error)}") from error


def run(session: Any, file: Path, feeds: dict[str, Any]) -> list[Any]:
    """Returns all outputs of a network.

    Raises:
        ConfigError: the network cannot be run with these inputs, or returns NaN or infinity.
    """
    try:
        outputs = [np.asarray(value) for value in session.run(None, feeds)]
    except Exception as error:  # onnxruntime does not export their types
        raise ConfigError(f"{file} cannot be run: {_reason(error)}") from error
    if not all(np.isfinite(value).all() for value in outputs if np.issubdtype(value.dtype, np.floating)):
        raise not_finite(file)
    return outputs


def not_finite(file: Path) -> ConfigError:
    """Returns the error of a network whose output has a NaN or an infinity."""
    return ConfigError(f"{file}: its output holds a NaN or an infinity; export it again")


def _has_external_data(message: memoryview, kind: str, depth: int) -> bool:
    """Returns whether a message contains a tensor whose values are in another file.

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
    """Returns the message of onnxruntime without its error code and the C++ function that raised it."""
    text = _SOURCE.sub("", _CODE.sub("", " ".join(str(error).split())))
    return clipped(text or type(error).__name__, _LONGEST_REASON).rstrip(".")
