"""ONNX files with the interfaces of networks that fill holes, which do something simple instead."""

from __future__ import annotations

import numpy as np

from support import onnx_bytes as ox


def _channels(first: int, last: int, output: str, *, axis: int = 1, of: str = "input") -> tuple[bytes, dict[str, np.ndarray]]:
    """Returns a node that cuts channels, or a part of another axis, out of a tensor, and its constants."""
    names = [f"{output}_{part}" for part in ("first", "last", "axis")]
    values = (np.array([value]) for value in (first, last, axis))
    return ox.node("Slice", [of, *names], output), dict(zip(names, values, strict=True))


def our_network(
    channels: int = 9, depth: bool = False, version: str = "1", nan: bool = False, size: int | None = None, offset: float = 0.5,
    gain: float = 1.0, depth_channel: int = 3,
) -> bytes:  # fmt: skip
    """Returns a network of our kind: its picture is its input's times ``gain``, its inverse depth a channel of its input plus ``offset``."""
    cut, tensors = _channels(0, 3, "cut")
    nodes, outputs = [cut], [ox.value("image", "float32", [1, 3, "h", "w"])]
    if not nan:
        nodes, tensors = [*nodes, ox.node("Mul", ["cut", "gain"], "image")], {**tensors, "gain": np.float32(gain)}
    if nan:
        nodes += [ox.node("Sub", ["cut", "two"], "below"), ox.node("Sqrt", ["below"], "image")]
        tensors["two"] = np.float32(2.0)
    if depth:
        cut, more = _channels(depth_channel, depth_channel + 1, "inverse")
        nodes += [cut, ox.node("Add", ["inverse", "offset"], "inverse_depth")]
        tensors = {**tensors, **more, "offset": np.float32(offset)}
        outputs.append(ox.value("inverse_depth", "float32", [1, 1, "h", "w"]))
    made = ox.model(nodes, [ox.value("input", "float32", [1, channels, size or "h", size or "w"])], outputs, tensors)
    return made + ox.message(14, ox.message(1, "gibson_filler") + ox.message(2, version))


def network_that_cuts_rows(rows: int) -> bytes:
    """Returns a network of our kind whose picture is its input's without the first rows."""
    (picture, tensors), (lower, more) = _channels(0, 3, "picture"), _channels(rows, 1 << 20, "image", axis=2, of="picture")
    inputs, outputs = ox.value("input", "float32", [1, 9, "h", "w"]), ox.value("image", "float32", [1, 3, "g", "w"])
    return ox.model([picture, lower], [inputs], [outputs], {**tensors, **more})


def network_that_fails_with_holes(share: float) -> bytes:
    """Returns a network of our kind whose picture is its input's, and NaN where holes are more than a share of the picture."""
    (picture, tensors), (holes, more) = _channels(0, 3, "picture"), _channels(7, 8, "holes")
    nodes = [
        picture, holes, ox.node("ReduceMean", ["holes"], "mean", keepdims=1), ox.node("Sub", ["share", "mean"], "left"),
        ox.node("Sqrt", ["left"], "root"), ox.node("Mul", ["root", "zero"], "nothing"), ox.node("Add", ["picture", "nothing"], "image"),
    ]  # fmt: skip
    inputs, outputs = (ox.value(name, "float32", [1, channels, "h", "w"]) for name, channels in (("input", 9), ("image", 3)))
    return ox.model(nodes, [inputs], [outputs], {**tensors, **more, "share": np.float32(share), "zero": np.float32(0.0)})


def pipeline() -> bytes:
    """Returns a network with the interface of MI-GAN's pipeline, which paints holes with 7."""
    nodes = [ox.node("Cast", ["mask"], "known", to=9), ox.node("Where", ["known", "image", "seven"], "result")]
    inputs = [ox.value("image", "uint8", ["n", 3, "h", "w"]), ox.value("mask", "uint8", ["n", 1, "h", "w"])]
    return ox.model(
        nodes, inputs, [ox.value("result", "uint8", ["n", 3, "h", "w"])], {"seven": np.full((1, 1, 1, 1), 7, np.uint8)}
    )


def generator() -> bytes:
    """Returns a network with the interface of MI-GAN's generator: white where the mask says known, black where it says unknown."""
    cut, tensors = _channels(0, 1, "half")
    nodes = [cut, ox.node("Mul", ["half", "two"], "mask"), ox.node("Concat", ["mask", "mask", "mask"], "output", axis=1)]
    shapes = ox.value("input", "float32", [1, 4, 32, 32]), ox.value("output", "float32", [1, 3, 32, 32])
    return ox.model(nodes, [shapes[0]], [shapes[1]], {**tensors, "two": np.float32(2.0)})
