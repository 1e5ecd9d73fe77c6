"""Wraps Blender's shader nodes, the elements of patterns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

Socket = Any
Value = Any
"""A socket of another node, a number, or a vector or colour as a tuple."""


class Graph:
    """Builds the node graph of one material."""

    def __init__(self, material: Any) -> None:
        self.tree = material.node_tree
        self.tree.nodes.clear()
        attribute = self._node("ShaderNodeAttribute", attribute_name="tint")
        self.tint: Socket = attribute.outputs["Color"]
        self.coords: Socket = self._node("ShaderNodeAttribute", attribute_name="place").outputs["Vector"]

    def _node(self, kind: str, **settings: Any) -> Any:
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        return node

    def _put(self, socket: Any, value: Value) -> None:
        if hasattr(value, "is_output"):
            self.tree.links.new(value, socket)
        elif isinstance(value, tuple) and len(value) == 3 and socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def math(self, operation: str, a: Value, b: Value = 0.0, c: Value = 0.0) -> Socket:
        """Returns the result of a math node."""
        node = self._node("ShaderNodeMath", operation=operation)
        for socket, value in zip(node.inputs, (a, b, c), strict=False):
            self._put(socket, value)
        return node.outputs[0]

    def scaled(self, vector: Value, factors: Sequence[float], shift: Value = (0.0, 0.0, 0.0)) -> Socket:
        """Returns vector * factors + shift."""
        node = self._node("ShaderNodeVectorMath", operation="MULTIPLY_ADD")
        for socket, value in zip(node.inputs, (vector, tuple(factors), shift), strict=False):
            self._put(socket, value)
        return node.outputs[0]

    def parts(self, vector: Value) -> tuple[Socket, Socket, Socket]:
        """Returns the components x, y, z of a vector."""
        node = self._node("ShaderNodeSeparateXYZ")
        self._put(node.inputs[0], vector)
        return tuple(node.outputs)

    def vector(self, x: Value, y: Value, z: Value) -> Socket:
        """Returns a vector with three components."""
        node = self._node("ShaderNodeCombineXYZ")
        for socket, value in zip(node.inputs, (x, y, z), strict=True):
            self._put(socket, value)
        return node.outputs[0]

    def noise(self, vector: Value, scale: float, detail: float = 3.0, distortion: float = 0.0) -> Socket:
        """Returns noise around 0.5."""
        node = self._node("ShaderNodeTexNoise", noise_dimensions="3D")
        self._put(node.inputs["Vector"], vector)
        for name, value in (("Scale", scale), ("Detail", detail), ("Distortion", distortion)):
            node.inputs[name].default_value = value
        return node.outputs[0]

    def cells(self, vector: Value, scale: float) -> tuple[Socket, Socket]:
        """Returns the distance from the centre of the Voronoi cell, and the random colour of the cell."""
        node = self._node("ShaderNodeTexVoronoi")
        self._put(node.inputs["Vector"], vector)
        node.inputs["Scale"].default_value = scale
        return node.outputs["Distance"], node.outputs["Color"]

    def bricks(self, vector: Value, width: float, height: float, gap: float, offset: float = 0.5) -> tuple[Socket, Socket]:
        """Returns a random number for each brick, 0 to 1, and a mask that is 1 in the joints."""
        node = self._node("ShaderNodeTexBrick", offset=offset, offset_frequency=2)
        self._put(node.inputs["Vector"], vector)
        for name, value in (
            ("Scale", 1.0), ("Mortar Size", gap), ("Mortar Smooth", 0.1), ("Bias", 0.0), ("Brick Width", width), ("Row Height", height),
            ("Color1", (0.0, 0.0, 0.0, 1.0)), ("Color2", (1.0, 1.0, 1.0, 1.0)), ("Mortar", (0.5, 0.5, 0.5, 1.0)),
        ):  # fmt: skip
            node.inputs[name].default_value = value
        return node.outputs["Color"], node.outputs["Fac"]

    def map_range(self, value: Value, low: float, high: float, to_low: float = 0.0, to_high: float = 1.0) -> Socket:
        """Maps a value from one range to another, clamped."""
        node = self._node("ShaderNodeMapRange", clamp=True)
        for name, number in (("From Min", low), ("From Max", high), ("To Min", to_low), ("To Max", to_high)):
            node.inputs[name].default_value = number
        self._put(node.inputs["Value"], value)
        return node.outputs[0]

    def scale_color(self, color: Value, factor: Value) -> Socket:
        """Returns a colour multiplied by a factor."""
        node = self._node("ShaderNodeVectorMath", operation="SCALE")
        self._put(node.inputs[0], color)
        self._put(node.inputs["Scale"], factor)
        return node.outputs[0]

    def mix(self, factor: Value, a: Value, b: Value) -> Socket:
        """Returns the mix of two colours: ``a`` for factor 0, ``b`` for factor 1."""
        node = self._node("ShaderNodeMix", data_type="RGBA")
        self._put(node.inputs[0], factor)
        self._put(node.inputs[6], a)
        self._put(node.inputs[7], b)
        return node.outputs[2]

    def ramp(self, value: Value, colors: Sequence[tuple[float, float, float]]) -> Socket:
        """Returns a colour from a ramp with equal steps."""
        node = self._node("ShaderNodeValToRGB")
        node.color_ramp.interpolation = "CONSTANT"
        elements = node.color_ramp.elements
        while len(elements) < len(colors):
            elements.new(1.0)
        for k, color in enumerate(colors):
            elements[k].position = k / len(colors)
            elements[k].color = (*color, 1.0)
        self._put(node.inputs[0], value)
        return node.outputs[0]

    def finish(self, color: Value, emission: float = 0.0) -> Any:
        """Completes the material with a diffuse or emissive surface; returns the image node, the target of the bake."""
        shader = self._node("ShaderNodeEmission") if emission else self._node("ShaderNodeBsdfDiffuse")
        self._put(shader.inputs["Color"], color)
        if emission:
            shader.inputs["Strength"].default_value = emission
        output = self._node("ShaderNodeOutputMaterial")
        self.tree.links.new(shader.outputs[0], output.inputs["Surface"])
        target = self._node("ShaderNodeTexImage")
        self.tree.nodes.active = target
        return target
