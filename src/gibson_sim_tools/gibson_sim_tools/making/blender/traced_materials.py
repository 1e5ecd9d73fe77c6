"""Materials of traced pictures: mirrors and glass of buildings, materials of mesh files, and the world. Numbers name those that reflect."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import bpy

PLAIN, MIRROR, GLASS, METAL = 0, 1, 2, 3
"""Numbers of the kinds of materials, in the pass of the materials."""
_REFLECTANCE = 0.88
"""Reflectance of a mirror."""
_PANE = (0.97, 0.985, 0.98)
"""Transmittance of a pane of glass, linear."""
_OUTSIDE_RADIANCE = 3.0
"""Radiance of white in the backdrop, as the mirrors of a building and its metals see it."""
_MIN_METALLIC = 0.5
"""Metalness from which a material counts as a metal."""
_MAX_GLOSSY_ROUGHNESS = 0.25
"""Roughness up to which a material counts as glossy."""


def make_mirror(material: Any) -> None:
    """Turns a material into a mirror."""
    tree, output = _cleared(material)
    shader = tree.nodes.new("ShaderNodeBsdfGlossy")
    shader.inputs["Color"].default_value = (_REFLECTANCE, _REFLECTANCE, _REFLECTANCE, 1.0)
    shader.inputs["Roughness"].default_value = 0.0
    tree.links.new(shader.outputs[0], output.inputs["Surface"])
    material.pass_index = MIRROR


def glass() -> Any:
    """Returns the material of a thin pane: a camera sees reflections in it, and light passes unchanged, as in the bake."""
    material = bpy.data.materials.new("glass")
    material.use_nodes = True
    tree, output = _cleared(material)
    clear, tinted = (tree.nodes.new("ShaderNodeBsdfTransparent") for _ in range(2))
    tinted.inputs["Color"].default_value = (*_PANE, 1.0)
    gloss, fresnel, seen = (tree.nodes.new(f"ShaderNode{kind}") for kind in ("BsdfGlossy", "Fresnel", "MixShader"))
    gloss.inputs["Roughness"].default_value = 0.0
    fresnel.inputs["IOR"].default_value = 1.45
    tree.links.new(fresnel.outputs[0], seen.inputs[0])
    tree.links.new(tinted.outputs[0], seen.inputs[1])
    tree.links.new(gloss.outputs[0], seen.inputs[2])
    path, mix = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMixShader")
    tree.links.new(path.outputs["Is Camera Ray"], mix.inputs[0])
    tree.links.new(clear.outputs[0], mix.inputs[1])
    tree.links.new(seen.outputs[0], mix.inputs[2])
    tree.links.new(mix.outputs[0], output.inputs["Surface"])
    material.pass_index = GLASS
    return material


def mesh_material(values: dict[str, Any], work: Path) -> Any:
    """Returns the material of a part of a mesh file.

    Args:
        values: as in ``scene.json``: colours linear, textures as names of files.
        work: folder of the textures.
    """
    material = bpy.data.materials.new("part")
    material.use_nodes = True
    tree, output = _cleared(material)
    color = _color(tree, values, work)
    if values["unlit"]:
        shader = tree.nodes.new("ShaderNodeEmission")
        _connect(tree, color, shader.inputs["Color"])
        surface = shader.outputs[0]
    else:
        shader = tree.nodes.new("ShaderNodeBsdfPrincipled")
        _connect(tree, color, shader.inputs["Base Color"])
        _set_up_gloss(tree, shader, values, work)
        _set_up_relief(tree, shader, values, work)
        surface = shader.outputs[0]
        if any(values["emissive"]) or values["emissive_texture"]:
            surface = _with_emission(tree, surface, values, work)
        if values["metallic"] >= _MIN_METALLIC or values["roughness"] <= _MAX_GLOSSY_ROUGHNESS:
            material.pass_index = METAL
    alpha = _alpha(tree, values, work)
    if alpha is not None:
        mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
        _connect(tree, alpha, mix.inputs[0])
        tree.links.new(clear.outputs[0], mix.inputs[1])
        tree.links.new(surface, mix.inputs[2])
        surface = mix.outputs[0]
        material.pass_index = GLASS
    tree.links.new(surface, output.inputs["Surface"])
    return material


def backdrop_world(world: Any, light: dict[str, Any], *, is_lit: bool) -> None:
    """Gives the world its light and, for rays from mirrors and metals, the backdrop. Cameras see through it: its alpha is 0.

    Args:
        world: Blender's world.
        light: light of the scene, as in ``scene.json``.
        is_lit: whether ambient light and environment of the scene light it; the light of a generated building is its own.
    """
    world.use_nodes = True
    tree = world.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputWorld")
    shader = tree.nodes.new("ShaderNodeBackground")
    ambient = light["ambient"] if is_lit else 0.0
    shader.inputs[0].default_value, shader.inputs[1].default_value = (1.0, 1.0, 1.0, 1.0), ambient
    surface = shader.outputs[0]
    if is_lit and light["environment"]:
        add = tree.nodes.new("ShaderNodeAddShader")
        tree.links.new(surface, add.inputs[0])
        tree.links.new(
            _panorama(tree, light["environment"], light["environment_yaw"], light["environment_strength"]), add.inputs[1]
        )
        surface = add.outputs[0]
    if light["backdrop"]:
        path, mix = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMixShader")
        tree.links.new(path.outputs["Is Glossy Ray"], mix.inputs[0])
        tree.links.new(surface, mix.inputs[1])
        tree.links.new(_panorama(tree, light["backdrop"], 0.0, 1.0 if is_lit else _OUTSIDE_RADIANCE), mix.inputs[2])
        surface = mix.outputs[0]
    tree.links.new(surface, output.inputs["Surface"])


def _panorama(tree: Any, path: str, yaw: float, strength: float) -> Any:
    """Adds a background from an equirectangular image; returns its shader."""
    image, shader = tree.nodes.new("ShaderNodeTexEnvironment"), tree.nodes.new("ShaderNodeBackground")
    image.image = bpy.data.images.load(path, check_existing=True)
    place, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
    mapping.inputs["Rotation"].default_value = (0.0, 0.0, -yaw)
    tree.links.new(place.outputs["Generated"], mapping.inputs["Vector"])
    tree.links.new(mapping.outputs[0], image.inputs["Vector"])
    tree.links.new(image.outputs["Color"], shader.inputs[0])
    shader.inputs[1].default_value = strength
    return shader.outputs[0]


def _cleared(material: Any) -> tuple[Any, Any]:
    """Removes the nodes of a material; returns its node tree and a new output."""
    tree = material.node_tree
    tree.nodes.clear()
    return tree, tree.nodes.new("ShaderNodeOutputMaterial")


def _connect(tree: Any, value: Any, socket: Any) -> None:
    if hasattr(value, "is_output"):
        tree.links.new(value, socket)
    else:
        socket.default_value = value


def _image(tree: Any, texture: dict[str, Any], work: Path, *, is_color: bool) -> Any:
    """Adds the node of a texture; returns it."""
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = bpy.data.images.load(str(work / texture["file"]), check_existing=True)
    node.image.colorspace_settings.name = "sRGB" if is_color else "Non-Color"
    node.image.alpha_mode = "CHANNEL_PACKED"
    node.extension = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}[texture["wrap"]]
    return node


def _product(tree: Any, a: Any, b: Any) -> Any:
    """Returns the product of two colours; each is a socket or a colour."""
    node = tree.nodes.new("ShaderNodeMix")
    node.data_type, node.blend_type, node.clamp_result = "RGBA", "MULTIPLY", False
    node.inputs[0].default_value = 1.0
    _connect(tree, a, node.inputs[6])
    _connect(tree, b, node.inputs[7])
    return node.outputs[2]


def _color(tree: Any, values: dict[str, Any], work: Path) -> Any:
    color: Any = (*values["color"][:3], 1.0)
    if values["texture"]:
        color = _product(tree, _image(tree, values["texture"], work, is_color=True).outputs["Color"], color)
    if values["colored"]:
        attribute = tree.nodes.new("ShaderNodeAttribute")
        attribute.attribute_name = "color"
        color = _product(tree, attribute.outputs["Color"], color)
    return color


def _alpha(tree: Any, values: dict[str, Any], work: Path) -> Any:
    """Returns the opacity, a number or a socket; None = opaque."""
    if values["alpha_mode"] == "opaque":
        return None
    alpha: Any = values["color"][3]
    if values["texture"]:
        node = tree.nodes.new("ShaderNodeMath")
        node.operation = "MULTIPLY"
        tree.links.new(_image(tree, values["texture"], work, is_color=True).outputs["Alpha"], node.inputs[0])
        node.inputs[1].default_value = alpha
        alpha = node.outputs[0]
    if values["alpha_mode"] == "mask":
        cut = tree.nodes.new("ShaderNodeMath")
        cut.operation = "GREATER_THAN"
        _connect(tree, alpha, cut.inputs[0])
        cut.inputs[1].default_value = values["alpha_cutoff"]
        alpha = cut.outputs[0]
    return alpha


def _set_up_gloss(tree: Any, shader: Any, values: dict[str, Any], work: Path) -> None:
    shader.inputs["Roughness"].default_value = values["roughness"]
    shader.inputs["Metallic"].default_value = values["metallic"]
    if not values["metallic_roughness_texture"]:
        return
    parts = tree.nodes.new("ShaderNodeSeparateColor")
    tree.links.new(_image(tree, values["metallic_roughness_texture"], work, is_color=False).outputs["Color"], parts.inputs[0])
    for name, channel in (("Roughness", 1), ("Metallic", 2)):
        node = tree.nodes.new("ShaderNodeMath")
        node.operation = "MULTIPLY"
        tree.links.new(parts.outputs[channel], node.inputs[0])
        node.inputs[1].default_value = values[name.lower()]
        tree.links.new(node.outputs[0], shader.inputs[name])


def _set_up_relief(tree: Any, shader: Any, values: dict[str, Any], work: Path) -> None:
    if values["normal_texture"]:
        node = tree.nodes.new("ShaderNodeNormalMap")
        node.inputs["Strength"].default_value = values["normal_scale"]
        tree.links.new(_image(tree, values["normal_texture"], work, is_color=False).outputs["Color"], node.inputs["Color"])
        tree.links.new(node.outputs[0], shader.inputs["Normal"])


def _with_emission(tree: Any, surface: Any, values: dict[str, Any], work: Path) -> Any:
    """Returns a surface that also emits light."""
    glow, add = tree.nodes.new("ShaderNodeEmission"), tree.nodes.new("ShaderNodeAddShader")
    color: Any = (*values["emissive"], 1.0)
    if values["emissive_texture"]:
        color = _product(tree, _image(tree, values["emissive_texture"], work, is_color=True).outputs["Color"], color)
    _connect(tree, color, glow.inputs["Color"])
    tree.links.new(surface, add.inputs[0])
    tree.links.new(glow.outputs[0], add.inputs[1])
    return add.outputs[0]
