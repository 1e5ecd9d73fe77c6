"""A small network of the form of ours that is made by hand: the colours of a recorded image tell where it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from support.onnx_bytes import message, model, node, value

_FLOAT = 1
OUTPUTS = ("pose", "scale", "match", "hit")
EDGES = np.linspace(0.0, 3.0, 31)
METADATA = {
    "hfov_deg": "100",
    "free_edges": ",".join(f"{edge:.1f}" for edge in EDGES),
    "offset_ratio": "1",
    "offset_deviation": "0",
}


def path_model(
    free: Sequence[float],
    *,
    metadata: Mapping[str, str] = METADATA,
    outputs: Sequence[str] = OUTPUTS,
    earlier: bool = False,
    poses: int | None = None,
) -> bytes:
    """Returns the bytes of an ONNX file.

    x is the mean red / 100 m, y (green - 100) / 100 m, yaw (blue - 100) / 100 rad; an image matches if its mean red is above 0; the expected
    errors are 0.05.

    Args:
        free: free distances that it always sees, metres; bins are 0.1 m wide, 3 and more is nothing.
        metadata: that of the file.
        outputs: their names.
        earlier: it has the input ``earlier``, which tells it nothing.
        poses: number of poses that it always returns; None = one for each recorded image.
    """
    nodes = [
        node("Cast", ["recorded"], "floats", to=_FLOAT),
        node("ReduceMean", ["floats"], "mean", axes=[1, 2], keepdims=0),
        node("Sub", ["mean", "zero_at"], "shifted"),
        node("Mul", ["shifted", "hundredth"], outputs[0]) if poses is None else node("Identity", ["fixed"], outputs[0]),
        node("Mul", ["mean", "none"], "nothing"),
        node("Add", ["nothing", "error"], outputs[1]),
        node("Mul", ["mean", "only_red"], "red"),
        node("ReduceMax", ["red"], "reddest", axes=[1], keepdims=0),
        node("Sign", ["reddest"], outputs[2]),
        node("Identity", ["first_thing"], outputs[3]),
    ]
    hit = np.zeros((len(free), len(EDGES)))
    hit[np.arange(len(free)), np.digitize(free, EDGES) - 1] = 1.0
    constants: dict[str, Any] = {
        "first_thing": hit,
        "zero_at": [0, 100, 100],
        "hundredth": [0.01],
        "none": [0],
        "error": [0.05],
        "only_red": [1, 0, 0],
        "fixed": np.zeros((poses or 0, 3)),
    }
    inputs = [value("present", "uint8", [1, 64, 96, 3]), value("recorded", "uint8", ["k", 64, 96, 3])]
    if earlier:
        inputs.append(value("earlier", "uint8", [1, 64, 96, 3]))
    shapes: list[list[int | str]] = [["k", 3], ["k", 3], ["k"], list(hit.shape)]
    ports = [value(name, "float32", shape) for name, shape in zip(outputs, shapes, strict=True)]
    content = model(nodes, inputs, ports, {name: np.array(some, np.float32) for name, some in constants.items()})
    return content + b"".join(message(14, message(1, key) + message(2, text)) for key, text in metadata.items())
