"""Renders the reflections of mirrors, from one viewpoint in front of each."""

from __future__ import annotations

import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import mathutils
import numpy as np

from gibson_sim_tools.making.blender.assembly import Assembly
from gibson_sim_tools.making.blender.denoise import F32, denoised
from gibson_sim_tools.making.blender.shapes import F64

_DISTANCE = 1.5
"""Distance of the viewpoint from the mirror, metres."""
_LONG_PX = 384
_OUTSIDE = 3.0
"""Radiance of the sky behind windows."""


@dataclass(frozen=True)
class Mirror:
    """A rectangular mirror."""

    corners: F64
    """(4, 3): lower left, lower right, upper right, upper left, seen from its front; world."""
    uv: F64
    """(4, 2): atlas coordinates of the corners."""
    atlas: int


def mirrors_of(assembly: Assembly) -> list[Mirror]:
    """Returns the mirrors of a building, each of two triangles that begin at the lower left."""
    if "mirror" not in assembly.patterns:
        return []
    rows = np.flatnonzero(assembly.pattern == assembly.patterns.index("mirror"))
    found = []
    for first, second in rows.reshape(-1, 2):
        corners = np.concatenate([assembly.corners[first], assembly.corners[second][2:]])
        uv = np.concatenate([assembly.uv[first], assembly.uv[second][2:]])
        found.append(Mirror(corners, uv, int(assembly.atlas[first])))
    return found


def reflection(mirror: Mirror, samples: int) -> F32:
    """Returns the reflection in a mirror, (H, W, 3) linear, row 0 at the bottom. The scene is that of the ``Stage``."""
    right, up = mirror.corners[1] - mirror.corners[0], mirror.corners[3] - mirror.corners[0]
    width, height = float(np.linalg.norm(right)), float(np.linalg.norm(up))
    normal = np.cross(right, up) / (width * height)
    scene = bpy.context.scene
    scale = _LONG_PX / max(width, height)
    scene.render.resolution_x, scene.render.resolution_y = max(16, round(width * scale)), max(16, round(height * scale))
    data = bpy.data.cameras.new("mirror")
    data.sensor_fit = "HORIZONTAL"
    data.angle = 2 * np.arctan(width / 2 / _DISTANCE)
    data.clip_start = _DISTANCE + 0.01
    camera = bpy.data.objects.new("mirror", data)
    scene.collection.objects.link(camera)
    camera.location = mirror.corners.mean(axis=0) - normal * _DISTANCE
    camera.rotation_euler = mathutils.Vector(normal).to_track_quat("-Z", "Y").to_euler()
    scene.camera = camera
    scene.cycles.samples = samples
    _bright_sky(scene.world)
    # Rendered from behind, so left and right are exchanged.
    return denoised(np.ascontiguousarray(_rendered(scene)[:, ::-1]))


def _rendered(scene: Any) -> F32:
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
    """Makes the sky bright for camera rays only."""
    tree = world.node_tree
    path, strength = tree.nodes.new("ShaderNodeLightPath"), tree.nodes.new("ShaderNodeMath")
    strength.operation = "MULTIPLY"
    strength.inputs[1].default_value = _OUTSIDE
    tree.links.new(path.outputs["Is Camera Ray"], strength.inputs[0])
    tree.links.new(strength.outputs[0], tree.nodes["Background"].inputs[1])
