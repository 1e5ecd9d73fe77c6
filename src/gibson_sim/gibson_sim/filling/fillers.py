"""Fillers: methods that fill holes in camera images, selected by ``CameraSpec.fill``."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError
from gibson_sim.filling.holes import SURFACE, Filled, Filler, is_hole
from gibson_sim.filling.inputs import filled_colour
from gibson_sim.filling.onnx_files import MAX_BYTES
from gibson_sim.filling.push_pull import push_pull_depth
from gibson_sim.reading import read_file

F32 = NDArray[np.float32]
U8 = NDArray[np.uint8]
LEARNED = Path(__file__).with_name("models") / "filler.onnx"
"""The network that ships with the package."""


class PushPull:
    """Fills holes by push-pull; other pixels do not change."""

    def fill(self, colour: U8, depth: F32, normals: F32, hole: U8, *, with_depth: bool) -> Filled:
        """See ``Filler``."""
        return Filled(filled_colour(colour, hole), push_pull_depth(depth, is_hole(hole), hole == SURFACE) if with_depth else None)


def open_filler(fill: str, cuda_device: int = 0) -> Filler:
    """Returns the filler of a name or file.

    Args:
        fill: ``push_pull``, ``learned``, or the path of an ONNX file.
        cuda_device: CUDA device ordinal for networks, if onnxruntime supports CUDA.

    Raises:
        ConfigError: the network is missing or of an unknown kind, or onnxruntime is not installed.
    """
    if fill == "push_pull":
        return PushPull()
    if fill == "learned" and not LEARNED.is_file():
        raise ConfigError("fill: this installation has no learned network; give push_pull, or the path of an ONNX file")
    # onnxruntime takes half a second to import, so it is only imported if needed.
    from gibson_sim.filling.network import open_network

    return open_network(_file_of(fill), cuda_device)


def uses_network(fill: str) -> bool:
    """Returns whether a value of ``CameraSpec.fill`` names a network, which can fail at any image."""
    return fill not in ("", "push_pull")


def network_digests(fills: Iterable[str]) -> dict[str, str]:
    """Returns the SHA-256 of the files of the networks among values of ``CameraSpec.fill``; empty if a file cannot be read."""
    return {fill: _sha256(_file_of(fill)) for fill in fills if uses_network(fill)}


def _file_of(fill: str) -> Path:
    return LEARNED if fill == "learned" else Path(fill)


def _sha256(file: Path) -> str:
    try:
        return hashlib.sha256(read_file(file, MAX_BYTES)).hexdigest()
    except OSError:
        return ""
