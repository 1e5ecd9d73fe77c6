"""Builds patterns as Cycles materials. They read the mesh attributes ``tint`` (colour) and ``place`` (m; x along grain or wall, y up).

Their elements are Blender's shader nodes, which ``_Graph`` wraps.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import bpy

_GLOW = 6.0
"""Radiance of lamps and shades, W/m²/sr."""
_Socket = Any
_Value = Any
"""A socket of another node, a number, or a vector or colour as a tuple."""


def make_material(pattern: str) -> tuple[Any, Any]:
    """Builds the material of a pattern; returns it and its image node, the target of the bake."""
    material = bpy.data.materials.new(pattern)
    material.use_nodes = True
    graph = _Graph(material)
    if pattern == "glow":
        return material, graph.finish(graph.tint, _GLOW)
    return material, graph.finish(PATTERNS[pattern](graph))


def _speckled(g: _Graph, color: _Socket, scale: float, amount: float, detail: float = 2.0) -> _Socket:
    """Adds speckles to a colour."""
    return g.scale_color(color, g.map_range(g.noise(g.coords, scale, detail), 0.25, 0.75, 1 - amount, 1 + amount))


def _plain(g: _Graph) -> _Socket:
    return _speckled(g, g.tint, 3.0, 0.025)


def _screen(g: _Graph) -> _Socket:
    """Returns black glass with a faint reflection of the room."""
    x, y, _ = g.parts(g.coords)
    sheen = g.noise(g.vector(g.math("MULTIPLY", g.math("ADD", x, y), 0.7), 0.0, 0.0), 1.0, 1.0)
    return g.mix(g.map_range(sheen, 0.35, 0.7), g.tint, (0.012, 0.013, 0.015))


def _plaster(g: _Graph) -> _Socket:
    return _speckled(g, _speckled(g, g.tint, 1.3, 0.03), 90.0, 0.025)


def _concrete(g: _Graph) -> _Socket:
    return _speckled(g, _speckled(g, g.tint, 1.7, 0.13, 6.0), 60.0, 0.07)


def _bricks(g: _Graph) -> _Socket:
    number, joint = g.bricks(g.coords, 0.25, 0.077, 0.006)
    stone = g.scale_color(g.tint, g.map_range(number, 0.0, 1.0, 0.72, 1.15))
    return g.mix(joint, _speckled(g, stone, 35.0, 0.16, 4.0), _speckled(g, (0.56, 0.53, 0.48), 120.0, 0.1))


def _tiles(width: float, height: float, offset: float, variation: float, gap: float = 0.0025) -> Callable[[_Graph], _Socket]:
    def tiles(g: _Graph) -> _Socket:
        number, joint = g.bricks(g.coords, width, height, gap, offset)
        tile = g.scale_color(g.tint, g.map_range(number, 0.0, 1.0, 1 - variation, 1 + 0.4 * variation))
        return g.mix(joint, _speckled(g, tile, 4.0, 0.03, 5.0), g.scale_color(g.tint, 0.58))

    return tiles


def _checker(g: _Graph) -> _Socket:
    x, y, _ = g.parts(g.coords)
    cells = g.math("ADD", g.math("FLOOR", g.math("DIVIDE", x, 0.3)), g.math("FLOOR", g.math("DIVIDE", y, 0.3)))
    dark = g.math("MODULO", g.math("ABSOLUTE", cells), 2.0)
    _, joint = g.bricks(g.coords, 0.3, 0.3, 0.0025, 0.0)
    tile = g.mix(dark, g.tint, (0.05, 0.055, 0.06))
    return g.mix(joint, _speckled(g, tile, 4.0, 0.04), (0.35, 0.34, 0.32))


def _grain(g: _Graph, vector: _Socket, color: _Socket, strength: float = 1.0) -> _Socket:
    """Returns a colour with wood grain along x."""
    rings = g.noise(g.scaled(vector, (0.9, 14.0, 14.0)), 1.0, 3.0, 1.2)
    fibres = g.noise(g.scaled(vector, (6.0, 170.0, 170.0)), 1.0, 2.0)
    first = g.scale_color(color, g.map_range(rings, 0.3, 0.7, 1 - 0.26 * strength, 1 + 0.16 * strength))
    return g.scale_color(first, g.map_range(fibres, 0.25, 0.75, 1 - 0.12 * strength, 1 + 0.08 * strength))


def _wood(g: _Graph) -> _Socket:
    return _grain(g, g.coords, g.tint)


def _planks(length: float, width: float, offset: float, variation: float) -> Callable[[_Graph], _Socket]:
    def planks(g: _Graph) -> _Socket:
        brick_number, joint = g.bricks(g.coords, length, width, 0.0016, offset)
        shift = g.vector(
            g.math("MULTIPLY", brick_number, 37.0), g.math("MULTIPLY", brick_number, 11.0), g.math("MULTIPLY", brick_number, 53.0)
        )
        shifted = g.scaled(g.coords, (1.0, 1.0, 1.0), shift)
        tone = g.scale_color(g.tint, g.map_range(brick_number, 0.0, 1.0, 1 - variation, 1 + variation * 0.7))
        return g.mix(g.math("MULTIPLY", joint, 0.8), _grain(g, shifted, tone, 0.9), g.scale_color(g.tint, 0.2))

    return planks


def _stripes(g: _Graph) -> _Socket:
    x, _, _ = g.parts(g.coords)
    band = g.math("GREATER_THAN", g.math("FRACT", g.math("DIVIDE", x, 0.12)), 0.5)
    return _speckled(g, g.scale_color(g.tint, g.map_range(band, 0.0, 1.0, 0.92, 1.04)), 120.0, 0.02)


def _carpet(g: _Graph) -> _Socket:
    return _speckled(g, _speckled(g, g.tint, 2.0, 0.06), 140.0, 0.24, 3.0)


def _fabric(g: _Graph) -> _Socket:
    return _speckled(g, _speckled(g, g.tint, 5.0, 0.05), 190.0, 0.16)


def _cloth_stripes(g: _Graph) -> _Socket:
    _, y, _ = g.parts(g.coords)
    band = g.math("GREATER_THAN", g.math("FRACT", g.math("DIVIDE", y, 0.09)), 0.66)
    return _speckled(g, g.mix(band, g.tint, (0.10, 0.16, 0.26)), 190.0, 0.14)


def _leather(g: _Graph) -> _Socket:
    distance, _ = g.cells(g.coords, 160.0)
    return g.scale_color(_speckled(g, g.tint, 6.0, 0.14, 4.0), g.map_range(distance, 0.0, 0.6, 1.08, 0.86))


def _marble(g: _Graph) -> _Socket:
    waves = g.noise(g.coords, 1.6, 7.0, 1.4)
    vein = g.map_range(g.math("ABSOLUTE", g.math("SUBTRACT", waves, 0.5)), 0.0, 0.035, 1.0, 0.0)
    return g.mix(g.math("MULTIPLY", vein, 0.45), _speckled(g, g.tint, 2.0, 0.05, 5.0), (0.30, 0.30, 0.31))


def _terrazzo(g: _Graph) -> _Socket:
    distance, color = g.cells(g.coords, 55.0)
    number, hue, _ = g.parts(color)
    chip = g.math("MULTIPLY", g.math("LESS_THAN", distance, 0.34), g.math("GREATER_THAN", number, 0.45))
    stone = g.mix(hue, g.scale_color(g.tint, 0.45), g.scale_color(g.tint, 1.15))
    return g.mix(chip, _speckled(g, g.tint, 90.0, 0.05), stone)


def _leaves(g: _Graph) -> _Socket:
    return _speckled(g, _speckled(g, g.tint, 9.0, 0.2), 60.0, 0.1)


def _rug(g: _Graph) -> _Socket:
    x, y, number = g.parts(g.coords)
    ax, ay = g.math("ABSOLUTE", x), g.math("ABSOLUTE", y)
    edge = g.math("MAXIMUM", ax, ay)
    border = g.math("MULTIPLY", g.math("GREATER_THAN", edge, 0.86), g.math("LESS_THAN", edge, 0.93))
    diamonds = g.math(
        "ADD", g.math("PINGPONG", g.math("MULTIPLY", ax, 3.0), 0.5), g.math("PINGPONG", g.math("MULTIPLY", ay, 4.0), 0.5)
    )
    inner = g.math(
        "MULTIPLY",
        g.math("LESS_THAN", edge, 0.80),
        g.math("GREATER_THAN", g.math("FRACT", g.math("MULTIPLY", diamonds, 3.0)), 0.62),
    )
    has_diamonds = g.math("GREATER_THAN", number, 0.5)
    ornament = g.math("MAXIMUM", border, g.math("MULTIPLY", inner, has_diamonds))
    wear = g.noise(g.coords, 5.0, 4.0)
    color = g.mix(g.math("MULTIPLY", ornament, g.map_range(wear, 0.3, 0.6, 0.5, 0.9)), g.tint, (0.62, 0.56, 0.46))
    fibres = g.noise(g.coords, 220.0, 2.0)
    return g.scale_color(color, g.map_range(fibres, 0.25, 0.75, 0.84, 1.12))


def _art(g: _Graph) -> _Socket:
    """Returns an abstract picture: layers of hills, or fields of colour."""
    x, y, number = g.parts(g.coords)
    kind = g.math("GREATER_THAN", g.math("FRACT", g.math("MULTIPLY", number, 0.37)), 0.45)
    hills = g.math(
        "ADD",
        g.math("MULTIPLY", y, 0.42),
        g.math("MULTIPLY", g.noise(g.vector(x, g.math("MULTIPLY", y, 0.25), number), 1.4, 4.0), 0.9),
    )
    fields = g.noise(g.vector(x, y, number), 1.1, 0.5, 2.2)
    level = g.math(
        "ADD", g.math("MULTIPLY", kind, hills), g.math("MULTIPLY", g.math("SUBTRACT", 1.0, kind), g.map_range(fields, 0.3, 0.7))
    )
    tones = g.ramp(level, [(0.03, 0.05, 0.08), (0.13, 0.20, 0.24), (0.50, 0.24, 0.14), (0.72, 0.52, 0.30), (0.78, 0.74, 0.66)])
    paint = g.mix(0.45, tones, g.scale_color(g.tint, g.map_range(level, 0.0, 1.0, 0.25, 1.3)))
    return g.scale_color(paint, g.map_range(g.noise(g.coords, 22.0, 5.0), 0.25, 0.75, 0.86, 1.1))


PATTERNS: dict[str, Callable[[_Graph], _Socket]] = {
    "plain": _plain, "outside": _plain, "plaster": _plaster, "concrete": _concrete, "brick": _bricks,
    "tile_30": _tiles(0.3, 0.3, 0.0, 0.04), "tile_60": _tiles(0.6, 0.6, 0.0, 0.07), "metro": _tiles(0.2, 0.1, 0.5, 0.05), "checker": _checker,
    "planks": _planks(1.6, 0.145, 0.37, 0.2), "parquet": _planks(0.42, 0.07, 0.5, 0.26), "wood": _wood, "stripes": _stripes,
    "carpet": _carpet, "fabric": _fabric, "cloth_stripes": _cloth_stripes, "leather": _leather, "marble": _marble, "terrazzo": _terrazzo,
    "leaves": _leaves, "cardboard": _plaster, "rug": _rug, "art": _art, "mirror": _plain, "screen": _screen, "glass": _plain,
}  # fmt: skip


class _Graph:
    """Builds the node graph of one material."""

    def __init__(self, material: Any) -> None:
        self.tree = material.node_tree
        self.tree.nodes.clear()
        attribute = self._node("ShaderNodeAttribute", attribute_name="tint")
        self.tint: _Socket = attribute.outputs["Color"]
        self.coords: _Socket = self._node("ShaderNodeAttribute", attribute_name="place").outputs["Vector"]

    def _node(self, kind: str, **settings: Any) -> Any:
        node = self.tree.nodes.new(kind)
        for name, value in settings.items():
            setattr(node, name, value)
        return node

    def _put(self, socket: Any, value: _Value) -> None:
        if hasattr(value, "is_output"):
            self.tree.links.new(value, socket)
        elif isinstance(value, tuple) and len(value) == 3 and socket.type == "RGBA":
            socket.default_value = (*value, 1.0)
        else:
            socket.default_value = value

    def math(self, operation: str, a: _Value, b: _Value = 0.0, c: _Value = 0.0) -> _Socket:
        """Returns the result of a math node."""
        node = self._node("ShaderNodeMath", operation=operation)
        for socket, value in zip(node.inputs, (a, b, c), strict=False):
            self._put(socket, value)
        return node.outputs[0]

    def scaled(self, vector: _Value, factors: Sequence[float], shift: _Value = (0.0, 0.0, 0.0)) -> _Socket:
        """Returns vector * factors + shift."""
        node = self._node("ShaderNodeVectorMath", operation="MULTIPLY_ADD")
        for socket, value in zip(node.inputs, (vector, tuple(factors), shift), strict=False):
            self._put(socket, value)
        return node.outputs[0]

    def parts(self, vector: _Value) -> tuple[_Socket, _Socket, _Socket]:
        """Returns the components x, y, z of a vector."""
        node = self._node("ShaderNodeSeparateXYZ")
        self._put(node.inputs[0], vector)
        return tuple(node.outputs)

    def vector(self, x: _Value, y: _Value, z: _Value) -> _Socket:
        """Returns a vector with three components."""
        node = self._node("ShaderNodeCombineXYZ")
        for socket, value in zip(node.inputs, (x, y, z), strict=True):
            self._put(socket, value)
        return node.outputs[0]

    def noise(self, vector: _Value, scale: float, detail: float = 3.0, distortion: float = 0.0) -> _Socket:
        """Returns noise around 0.5."""
        node = self._node("ShaderNodeTexNoise", noise_dimensions="3D")
        self._put(node.inputs["Vector"], vector)
        for name, value in (("Scale", scale), ("Detail", detail), ("Distortion", distortion)):
            node.inputs[name].default_value = value
        return node.outputs[0]

    def cells(self, vector: _Value, scale: float) -> tuple[_Socket, _Socket]:
        """Returns the distance from the centre of the Voronoi cell, and the random colour of the cell."""
        node = self._node("ShaderNodeTexVoronoi")
        self._put(node.inputs["Vector"], vector)
        node.inputs["Scale"].default_value = scale
        return node.outputs["Distance"], node.outputs["Color"]

    def bricks(self, vector: _Value, width: float, height: float, gap: float, offset: float = 0.5) -> tuple[_Socket, _Socket]:
        """Returns a random number for each brick, 0 to 1, and a mask that is 1 in the joints."""
        node = self._node("ShaderNodeTexBrick", offset=offset, offset_frequency=2)
        self._put(node.inputs["Vector"], vector)
        for name, value in (
            ("Scale", 1.0), ("Mortar Size", gap), ("Mortar Smooth", 0.1), ("Bias", 0.0), ("Brick Width", width), ("Row Height", height),
            ("Color1", (0.0, 0.0, 0.0, 1.0)), ("Color2", (1.0, 1.0, 1.0, 1.0)), ("Mortar", (0.5, 0.5, 0.5, 1.0)),
        ):  # fmt: skip
            node.inputs[name].default_value = value
        return node.outputs["Color"], node.outputs["Fac"]

    def map_range(self, value: _Value, low: float, high: float, to_low: float = 0.0, to_high: float = 1.0) -> _Socket:
        """Maps a value from one range to another, clamped."""
        node = self._node("ShaderNodeMapRange", clamp=True)
        for name, number in (("From Min", low), ("From Max", high), ("To Min", to_low), ("To Max", to_high)):
            node.inputs[name].default_value = number
        self._put(node.inputs["Value"], value)
        return node.outputs[0]

    def scale_color(self, color: _Value, factor: _Value) -> _Socket:
        """Returns a colour multiplied by a factor."""
        node = self._node("ShaderNodeVectorMath", operation="SCALE")
        self._put(node.inputs[0], color)
        self._put(node.inputs["Scale"], factor)
        return node.outputs[0]

    def mix(self, factor: _Value, a: _Value, b: _Value) -> _Socket:
        """Returns the mix of two colours: ``a`` for factor 0, ``b`` for factor 1."""
        node = self._node("ShaderNodeMix", data_type="RGBA")
        self._put(node.inputs[0], factor)
        self._put(node.inputs[6], a)
        self._put(node.inputs[7], b)
        return node.outputs[2]

    def ramp(self, value: _Value, colors: Sequence[tuple[float, float, float]]) -> _Socket:
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

    def finish(self, color: _Value, emission: float = 0.0) -> Any:
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
