"""Renders the reflections in mirrors, each from one viewpoint in front of it."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

from gibson_sim_tools.making.blender.assembly import Assembly
from gibson_sim_tools.making.blender.denoise import F32, denoise
from gibson_sim_tools.making.blender.shapes import F64

_DISTANCE = 1.5
"""Distance of the viewpoint from the mirror, m."""
_LONG_SIDE_PX = 384
"""Longer side of a reflection, pixels."""
_SKY_RADIANCE = 3.0
"""Radiance of the sky behind windows."""


def mirrors_of(assembly: Assembly) -> list[F64]:
    """Returns the mirrors of a building: lower left, lower right, upper right, upper left corner, seen from the front, (4, 3), m, world frame.

    Each consists of two triangles that start at the lower left.
    """
    if "mirror" not in assembly.patterns:
        return []
    pairs = assembly.corners[assembly.pattern == assembly.patterns.index("mirror")].reshape(-1, 2, 3, 3)
    return [np.concatenate([first, second[2:]]) for first, second in pairs]


def reflection(corners: F64, samples: int) -> F32:
    """Renders the reflection in a mirror with these corners, (H, W, 3) linear, row 0 at the bottom, in the scene of the ``Stage``."""
    right, up = corners[1] - corners[0], corners[3] - corners[0]
    width, height = float(np.linalg.norm(right)), float(np.linalg.norm(up))
    normal = np.cross(right, up) / (width * height)
    scene = bpy.context.scene
    scale = _LONG_SIDE_PX / max(width, height)
    scene.render.resolution_x, scene.render.resolution_y = max(16, round(width * scale)), max(16, round(height * scale))
    data = bpy.data.cameras.new("mirror")
    data.sensor_fit = "HORIZONTAL"
    data.angle = 2 * np.arctan(width / 2 / _DISTANCE)
    data.clip_start = _DISTANCE + 0.01
    camera = bpy.data.objects.new("mirror", data)
    scene.collection.objects.link(camera)
    camera.location = corners.mean(axis=0) - normal * _DISTANCE
    camera.rotation_euler = mathutils.Vector(normal).to_track_quat("-Z", "Y").to_euler()
    scene.camera = camera
    scene.cycles.samples = samples
    _bright_sky(scene.world)
    # The camera is behind the mirror, so the image is flipped horizontally.
    return denoise(np.ascontiguousarray(_render_image(scene)[:, ::-1]))


def _render_image(scene: Any) -> F32:
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth = "OPEN_EXR", "32"
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "mirror.exr")
        bpy.ops.render.render(write_still=True)
        image = bpy.data.images.load(scene.render.filepath)
        pixels = np.empty(image.size[0] * image.size[1] * 4, dtype=np.float32)
        image.pixels.foreach_get(pixels)
        shape = (image.size[1], image.size[0], 4)
        bpy.data.images.remove(image)
    return pixels.reshape(shape)[..., :3]


def _bright_sky(world: Any) -> None:
    """Sets the radiance of the sky, for camera rays only."""
    tree = world.node_tree
    path, strength = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMath")
    strength.operation = "MULTIPLY"
    strength.inputs[1].default_value = _SKY_RADIANCE
    tree.links.new(path.outputs["Is Camera Ray"], strength.inputs[0])
    tree.links.new(strength.outputs[0], tree.nodes["Background"].inputs[1])
