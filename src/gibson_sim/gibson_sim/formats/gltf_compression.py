"""Decodes compressed glTF: Draco meshes and meshoptimizer buffers. Files are not trusted: every number is checked before its use."""

from __future__ import annotations

import io
import os
import subprocess
import sys
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError
from gibson_sim.quoting import clipped, quoted

DRACO = "KHR_draco_mesh_compression"
MESHOPT = ("EXT_meshopt_compression", "KHR_meshopt_compression")
MAX_DECODED_BYTES = 2**30
"""Maximum total size of the decoded buffers of one file, bytes."""
_TIMEOUT_S = 120.0
_WITHOUT_DRACO = "export the file without it, or convert it: npx @gltf-transform/cli copy in.glb out.glb"
_FILTERS = {"NONE": (), "OCTAHEDRAL": (4, 8), "QUATERNION": (8,), "EXPONENTIAL": tuple(range(4, 257, 4)), "COLOR": (4, 8)}
"""Filter -> its valid strides, bytes; empty = any."""


@dataclass(frozen=True, slots=True, eq=False)
class DracoMesh:
    """A decoded Draco mesh."""

    indices: NDArray[np.int64]
    """Vertex indices of the corners of the triangles, (3 F,)."""
    attributes: Mapping[int, NDArray[Any]]
    """Unique id of an attribute -> values, (V, C)."""


def decode_draco(where: str, meshes: Sequence[bytes]) -> list[DracoMesh]:
    """Returns decoded Draco meshes; decodes in a separate process, since the decoder may crash.

    Args:
        where: the file, for messages.
        meshes: the compressed bytes of each mesh.

    Raises:
        MeshError: DracoPy is not installed, or a mesh is corrupt or too large; one line.
    """
    if find_spec("DracoPy") is None:
        raise MeshError(f"{where}: is Draco compressed; install its decoder (pip install DracoPy), {_WITHOUT_DRACO}")
    data = b"".join(len(mesh).to_bytes(8, "little") + mesh for mesh in meshes)
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(os.path.abspath(entry) for entry in sys.path if entry),
        "OPENBLAS_NUM_THREADS": "1",
    }
    command = [sys.executable, "-m", "gibson_sim.formats.draco_process"]
    try:
        process = subprocess.run(
            command, input=data, env=environment, cwd=os.sep, capture_output=True, timeout=_TIMEOUT_S, check=False
        )
    except subprocess.TimeoutExpired as error:
        raise MeshError(
            f"{where}: its Draco meshes were not decoded after {_TIMEOUT_S:g} s; the file is broken or too large"
        ) from error
    if process.returncode:
        lines = process.stderr.decode(errors="replace").strip().splitlines()
        reason = clipped(lines[-1], 200) if lines else f"the decoder ended with code {process.returncode}"
        raise MeshError(f"{where}: a Draco mesh cannot be decoded ({reason}); the file is cut, broken, or too large")
    try:
        with np.load(io.BytesIO(process.stdout), allow_pickle=False) as arrays:
            output = {name: arrays[name] for name in arrays.files}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise MeshError(f"{where}: a Draco mesh cannot be decoded; the file is broken") from error
    return [_draco_mesh(i, output) for i in range(len(meshes))]


def _draco_mesh(number: int, output: Mapping[str, NDArray[Any]]) -> DracoMesh:
    """Returns a mesh from the output of ``draco_process``."""
    prefix = f"{number}_"
    values = {
        int(name[len(prefix) :]): array for name, array in output.items() if name.startswith(prefix) and name != f"{prefix}faces"
    }
    return DracoMesh(output[f"{prefix}faces"].reshape(-1).astype(np.int64), {k: v.reshape(len(v), -1) for k, v in values.items()})


def decode_meshopt(where: str, extension: Mapping[str, Any], data: bytes) -> bytes:
    """Returns the decoded bytes of a buffer view that is compressed with meshoptimizer.

    Args:
        where: the file, for messages.
        extension: ``count``, ``byteStride``, ``mode`` and ``filter`` of the file.
        data: the compressed bytes.

    Raises:
        MeshError: the parameters are invalid, or the data are corrupt; one line.
    """
    count, stride = (int(extension.get(key, 0)) for key in ("count", "byteStride"))
    mode, kind = str(extension.get("mode", "")), str(extension.get("filter", "NONE"))
    problem = _invalid(mode, kind, count, stride)
    if problem:
        raise MeshError(f"{where}: a compressed buffer has {problem}; the file is broken")
    if count == 0:
        return b""
    try:
        from meshoptimizer import decoder
    except ImportError as error:
        raise MeshError(f"{where}: is compressed with {MESHOPT[0]}; install its decoder (pip install meshoptimizer)") from error
    try:
        if mode == "ATTRIBUTES":
            array = decoder.decode_vertex_buffer(count, stride, data, np.dtype((np.void, stride)))
            raw = array.view(np.uint8)
            if kind == "COLOR":
                raw = _rgba(raw, "u1" if stride == 4 else "<u2")
            elif kind != "NONE":
                filters = {"OCTAHEDRAL": decoder.decode_filter_oct, "QUATERNION": decoder.decode_filter_quat}
                raw = filters.get(kind, decoder.decode_filter_exp)(raw, count, stride)
            return bytes(raw)
        decode = decoder.decode_index_buffer if mode == "TRIANGLES" else decoder.decode_index_sequence
        indices = decode(count, 4, data)
    except (RuntimeError, ValueError) as error:
        raise MeshError(f"{where}: a buffer compressed with {MESHOPT[0]} cannot be decoded; the file is cut or broken") from error
    return bytes(indices.astype("<u2" if stride == 2 else "<u4"))


def _rgba(raw: NDArray[np.uint8], dtype: str) -> NDArray[Any]:
    """Returns RGBA, (N, 4), from the filter COLOR: rows of Y, Co, Cg and alpha, each of K bits, where alpha is K - 1 bits below a 1."""
    stored = raw.view(dtype).reshape(-1, 4)
    y, alpha = stored[:, 0].astype(np.int64), stored[:, 3].astype(np.int64)
    co, cg = stored.view(dtype.replace("u", "i")).astype(np.int64)[:, 1:3].T
    largest = (1 << np.frexp(alpha.astype(np.float64))[1].astype(np.int64)) - 1  # of K bits
    below = alpha & (largest >> 1)
    rgba = np.stack([y + co - cg, y + cg, y - co - cg, below << 1 | below & 1], axis=1) / np.maximum(largest, 1)[:, None]
    rounded: NDArray[Any] = np.rint(np.clip(rgba, 0.0, 1.0) * np.iinfo(dtype).max).astype(dtype)
    return rounded


def _invalid(mode: str, kind: str, count: int, stride: int) -> str:
    """Returns a description of the invalid parameters of a compressed buffer, empty = all are valid."""
    if mode not in ("ATTRIBUTES", "TRIANGLES", "INDICES"):
        return f"mode {quoted(mode)}"
    if kind not in _FILTERS:
        return f"filter {quoted(kind)}"
    if count < 0 or count * stride > MAX_DECODED_BYTES:
        return f"{count} elements of {stride} bytes"
    if mode == "ATTRIBUTES":
        fits = 0 < stride <= 256 and stride % 4 == 0 and (not _FILTERS[kind] or stride in _FILTERS[kind])
    else:
        fits = stride in (2, 4) and kind == "NONE" and (mode == "INDICES" or count % 3 == 0)
    return "" if fits else f"{count} elements of {stride} bytes for mode {mode} and filter {kind}"
