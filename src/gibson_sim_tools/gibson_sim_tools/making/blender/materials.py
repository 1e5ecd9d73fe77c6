"""Builds Cycles materials: tiles of base colour times the mesh attribute ``factor``, single colours, lamps."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from gibson_sim_tools.making.tiles import Tile

_TOUCH_M = 0.0005
"""Distance up to which surfaces touch, as a floor and the underside of a box on it, m."""
_GLOW = 6.0
"""Radiance of lamps and shades, W/m²/sr."""


def tile_material(name: str, tile: Tile) -> tuple[Any, Any]:
    """Builds the material of a tile, which the mesh attribute ``tile`` places; returns it and its image node, the target of the bake."""
    material, tree = _new_material(name)
    texture = tree.nodes.new("ShaderNodeTexImage")
    texture.image, texture.interpolation, texture.extension = _image(name, tile), "Linear", "REPEAT"
    tree.links.new(_attribute(tree, "tile").outputs["Vector"], texture.inputs["Vector"])
    product = tree.nodes.new("ShaderNodeVectorMath")
    product.operation = "MULTIPLY"
    tree.links.new(texture.outputs["Color"], product.inputs[0])
    tree.links.new(_attribute(tree, "factor").outputs["Vector"], product.inputs[1])
    return material, _finish(tree, "ShaderNodeBsdfDiffuse", product.outputs[0])


def plain_material(pattern: str) -> tuple[Any, Any]:
    """Builds the material of a pattern without a tile; returns it and its image node, the target of the bake."""
    material, tree = _new_material(pattern)
    color = _attribute(tree, "factor").outputs["Vector"]
    return material, _finish(tree, "ShaderNodeEmission" if pattern == "glow" else "ShaderNodeBsdfDiffuse", color)


def probe_material(near_m: float) -> tuple[Any, Any]:
    """Builds a material that is red at the back of solids and where they touch, green within ``near_m`` (m); returns it and its image node."""
    material, tree = _new_material("probe")
    material.cycles.emission_sampling = "NONE"  # it is seen, but not sampled as a lamp
    solid = _math(tree, "SUBTRACT", 1.0, _attribute(tree, "thin").outputs["Fac"])
    back = _math(tree, "MULTIPLY", tree.nodes.new("ShaderNodeNewGeometry").outputs["Backfacing"], solid)
    distance = tree.nodes.new("ShaderNodeLightPath").outputs["Ray Length"]
    inside = _math(tree, "MAXIMUM", back, _math(tree, "LESS_THAN", distance, _TOUCH_M))
    near = _math(tree, "LESS_THAN", distance, near_m)
    color, emission, diffuse, both = (
        tree.nodes.new(f"ShaderNode{kind}") for kind in ("CombineXYZ", "Emission", "BsdfDiffuse", "AddShader")
    )
    tree.links.new(inside, color.inputs[0])
    tree.links.new(near, color.inputs[1])
    tree.links.new(color.outputs[0], emission.inputs["Color"])
    tree.links.new(diffuse.outputs[0], both.inputs[0])
    tree.links.new(emission.outputs[0], both.inputs[1])
    return material, _output(tree, both)


def _math(tree: Any, operation: str, a: Any, b: Any) -> Any:
    """Returns the result of a math node; ``a`` and ``b`` are sockets or numbers."""
    node = tree.nodes.new("ShaderNodeMath")
    node.operation = operation
    for socket, value in zip(node.inputs, (a, b), strict=False):
        if hasattr(value, "is_output"):
            tree.links.new(value, socket)
        else:
            socket.default_value = value
    return node.outputs[0]


def _new_material(name: str) -> tuple[Any, Any]:
    material = bpy.data.materials.new(name)
    material.use_nodes = True
    material.node_tree.nodes.clear()
    return material, material.node_tree


def _attribute(tree: Any, name: str) -> Any:
    node = tree.nodes.new("ShaderNodeAttribute")
    node.attribute_name = name
    return node


def _image(name: str, tile: Tile) -> Any:
    """Returns the pixels of a tile as an image of Blender, sRGB."""
    height, width = tile.pixels.shape[:2]
    image = bpy.data.images.new(name, width, height)
    pixels = np.ones((height, width, 4), dtype=np.float32)
    pixels[..., :3] = tile.pixels / np.float32(255.0)
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    return image


def _finish(tree: Any, kind: str, color: Any) -> Any:
    """Completes a material with a shader of a colour; returns the target of the bake."""
    shader = tree.nodes.new(kind)
    tree.links.new(color, shader.inputs["Color"])
    if kind == "ShaderNodeEmission":
        shader.inputs["Strength"].default_value = _GLOW
    return _output(tree, shader)


def _output(tree: Any, shader: Any) -> Any:
    """Makes a shader the surface; returns an image node, the target of the bake."""
    tree.links.new(shader.outputs[0], tree.nodes.new("ShaderNodeOutputMaterial").inputs["Surface"])
    target = tree.nodes.new("ShaderNodeTexImage")
    tree.nodes.active = target
    return target
