"""``python -m gibson_sim_tools.making.blender.trace WORK``: traces pictures of a scene with Cycles, in a Python interpreter with Blender.

WORK is a folder that ``gibson_sim_tools.tracing`` wrote: ``scene.json``, ``meshes.npz``, textures, and ``plan.json`` for a generated scene.
Each line on standard input requests one picture, as JSON; each line on standard output is JSON too: progress, or the end of a picture.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import GibsonSimError
from gibson_sim_tools.making.blender.assembly import Assembly, assemble
from gibson_sim_tools.making.blender.denoise import F32, denoise, is_noise
from gibson_sim_tools.making.blender.exr import read_exr
from gibson_sim_tools.making.blender.stage import Stage, new_scene
from gibson_sim_tools.making.blender.traced_materials import backdrop_world, glass, make_mirror, mesh_material
from gibson_sim_tools.making.building import Building, Quality, read_plan

_SENSOR_MM = 36.0
_LAMP_WATTS = 4.0 * np.pi**2
"""Power of a point lamp that makes a white surface white at 1 m, W."""


def main() -> None:
    """Builds the scene, then traces a picture for each line on standard input."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("work", type=Path)
    work = parser.parse_args().work
    # Blender writes to standard output, which is ours.
    answers = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)

    def answer(**values: Any) -> None:
        answers.write(json.dumps(values) + "\n")
        answers.flush()

    try:
        scene = TracedScene(work)
        answer(ready=f"{bpy.app.version_string}")
        for line in sys.stdin:
            request = json.loads(line)
            answer(done=request["output"], **scene.trace(request))
    except GibsonSimError as error:
        sys.exit(f"{error}")


class TracedScene:
    """A scene in Blender, with its moving links. ``work``: folder of the exported scene."""

    def __init__(self, work: Path) -> None:
        self._work = work
        description = json.loads((work / "scene.json").read_text(encoding="utf-8"))
        building, quality = read_plan(work / "plan.json") if (work / "plan.json").exists() else (None, None)
        if building is None or quality is None:
            self._scene = new_scene(0)
            self._scene.world = bpy.data.worlds.new("world")
            _add_lights(self._scene, description["light"])
        else:
            self._scene = _building_scene(building, quality)
        backdrop_world(self._scene.world, description["light"], is_lit=building is None)
        self._movers: list[tuple[int, NDArray[np.float64], Any]] = []
        """Index of the link, T_link_part and object of each moving part."""
        self._add_parts(description)
        self._camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
        self._scene.collection.objects.link(self._camera)
        self._scene.camera = self._camera
        _set_up_passes(self._scene)

    def _add_parts(self, description: dict[str, Any]) -> None:
        with np.load(self._work / "meshes.npz") as arrays:
            meshes = [_mesh(k, part, arrays, self._work) for k, part in enumerate(description["parts"])]
        for number, placement in enumerate(description["placements"]):
            part = bpy.data.objects.new(f"part_{number}", meshes[placement["part"]])
            self._scene.collection.objects.link(part)
            T = np.array(placement["matrix"]).reshape(4, 4)
            part.matrix_world = T.T
            if placement["link"] >= 0:
                part.pass_index = 1
                self._movers.append((placement["link"], T, part))

    def trace(self, request: dict[str, Any]) -> dict[str, Any]:
        """Traces a picture twice, with half of the samples each, and writes it; returns its noise.

        The file has ``rgb``, the mean of the halves, (H, W, 3) float16, linear, denoised where that changes it by less than the noise, for an opaque
        background of black; ``spread``, half of their difference; ``alpha``, (H, W) float16, 1 = covered; ``depth``, (H, W) float32, metres along
        the axis; ``moving`` and ``material``, (H, W) uint8: 1 on moving links, and the number of the material. Row 0 is the top.
        """
        for link, T_link_part, part in self._movers:
            part.matrix_world = (np.array(request["links"][link]).reshape(4, 4) @ T_link_part).T
        _place_camera(self._scene, self._camera, request)
        self._scene.cycles.samples = max(1, request["samples"] // 2)
        halves = []
        for seed in (2 * request["seed"], 2 * request["seed"] + 1):
            self._scene.cycles.seed = seed % 2**31
            halves.append(_rendered(self._scene))
        first, second = halves
        mean, albedo, normal = (np.asarray((first[k] + second[k]) / 2, dtype=np.float32) for k in ("rgb", "albedo", "normal"))
        spread = np.asarray((first["rgb"] - second["rgb"]) / 2, dtype=np.float32)
        smooth = denoise(mean, albedo=albedo, normal=normal)
        accepted = is_noise(mean, smooth, spread)
        rgb = np.asarray(np.where(accepted[..., None], smooth, mean), dtype=np.float32)
        output = Path(request["output"])
        draft = output.with_suffix(".part.npz")
        np.savez_compressed(
            draft, rgb=_half(rgb), spread=_half(spread), alpha=((first["alpha"] + second["alpha"]) / 2).astype(np.float16),
            depth=first["depth"], moving=first["moving"].astype(np.uint8), material=first["material"].astype(np.uint8),
        )  # fmt: skip
        os.replace(draft, output)
        return {"denoised": round(float(accepted.mean()), 4)}


def _half(values: F32) -> NDArray[np.float16]:
    return np.clip(np.nan_to_num(values), -6e4, 6e4).astype(np.float16)


def _building_scene(building: Building, quality: Quality) -> Any:
    """Builds a generated scene without the boxes that stand in for movable bodies in the bake; returns Blender's scene."""
    assembly = _exported(assemble(building, quality.atlases, quality.size_px))
    stage = Stage(building, assembly)
    if "mirror" in stage.materials:
        make_mirror(stage.materials["mirror"][0])
    if "glass" in assembly.patterns:
        stage.materials["glass"] = (glass(), None)
        rows = np.flatnonzero(assembly.pattern == assembly.patterns.index("glass"))
        stage.mesh_object(assembly, rows, "glass")
    for light in (item for item in stage.scene.objects if item.type == "LIGHT"):
        # Sky and fill lights are no visible things; the sky outside is the backdrop.
        light.visible_camera = light.visible_glossy = light.visible_transmission = False
    return stage.scene


def _exported(assembly: Assembly) -> Assembly:
    """Returns an assembly without the triangles that are not part of the scene."""
    keep = np.array(assembly.exported)[assembly.owner]
    names = ("corners", "owner", "pattern", "tint", "pattern_coords", "thin", "atlas", "uv")
    for name in names:
        setattr(assembly, name, getattr(assembly, name)[keep])
    return assembly


def _mesh(number: int, part: dict[str, Any], arrays: Any, work: Path) -> Any:
    """Returns a Blender mesh of an exported part."""
    triangles = arrays[f"triangles_{number}"]
    mesh = bpy.data.meshes.new(f"part_{number}")
    vertices = arrays[f"vertices_{number}"]
    mesh.vertices.add(len(vertices))
    mesh.vertices.foreach_set("co", vertices.astype(np.float32).ravel())
    mesh.loops.add(triangles.size)
    mesh.loops.foreach_set("vertex_index", triangles.ravel().astype(np.int32))
    mesh.polygons.add(len(triangles))
    mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    mesh.polygons.foreach_set("use_smooth", np.ones(len(triangles), dtype=bool))
    if f"uvs_{number}" in arrays:
        uvs = arrays[f"uvs_{number}"][triangles.ravel()] * [1.0, -1.0] + [0.0, 1.0]
        mesh.uv_layers.new(name="uv").uv.foreach_set("vector", uvs.astype(np.float32).ravel())
    if f"colors_{number}" in arrays:
        colors = mesh.attributes.new("color", "FLOAT_COLOR", "POINT")
        colors.data.foreach_set("color", arrays[f"colors_{number}"].astype(np.float32).ravel())
    mesh.materials.append(mesh_material(part["material"], work))
    mesh.update()
    mesh.normals_split_custom_set_from_vertices(arrays[f"normals_{number}"].astype(np.float32))
    return mesh


def _add_lights(scene: Any, light: dict[str, Any]) -> None:
    """Adds the sun and the lamps of a scene.yaml; ambient light and environment are in the world."""
    if light["sun"] > 0.0:
        data = bpy.data.lights.new("sun", "SUN")
        data.energy, data.color, data.angle = float(np.pi * light["sun"]), light["sun_color"], 0.0093
        data.use_shadow = light["shadows"]
        _add_lamp(scene, data, (0.0, 0.0, 0.0), light["sun_direction"])
    for point in light["points"]:
        is_spot = point["outer_angle"] < np.pi / 2
        data = bpy.data.lights.new("lamp", "SPOT" if is_spot else "POINT")
        data.energy, data.color, data.shadow_soft_size = float(_LAMP_WATTS * point["strength"]), point["color"], 0.03
        if is_spot:
            data.spot_size = 2.0 * point["outer_angle"]
            data.spot_blend = 1.0 - point["inner_angle"] / max(point["outer_angle"], 1e-6)
        _add_lamp(scene, data, point["position"], point["direction"])


def _add_lamp(scene: Any, data: Any, position: Any, direction: Any) -> None:
    import mathutils

    lamp = bpy.data.objects.new(data.name, data)
    scene.collection.objects.link(lamp)
    lamp.location = position
    lamp.rotation_euler = mathutils.Vector(direction).to_track_quat("-Z", "Y").to_euler()
    lamp.visible_camera = False


def _place_camera(scene: Any, camera: Any, request: dict[str, Any]) -> None:
    """Gives the camera pose and intrinsics: optical axes (x right, y down, z forward), pixel centres at whole numbers."""
    T = np.array(request["matrix"]).reshape(4, 4) @ np.diag([1.0, -1.0, -1.0, 1.0])
    camera.matrix_world = T.T
    (fx, _, cx), (_, fy, cy), _ = np.array(request["k"]).reshape(3, 3)
    width, height = request["width"], request["height"]
    data = camera.data
    data.sensor_fit, data.sensor_width = "HORIZONTAL", _SENSOR_MM
    data.lens = fx * _SENSOR_MM / width
    aspect = fx / fy
    render = scene.render
    render.pixel_aspect_x, render.pixel_aspect_y = max(1.0, 1.0 / aspect), max(1.0, aspect)
    data.shift_x = -(cx - (width - 1) / 2) / width
    data.shift_y = (cy - (height - 1) / 2) * aspect / width
    data.clip_start, data.clip_end = request["near"], request["far"]
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100


def _set_up_passes(scene: Any) -> None:
    layer = scene.view_layers[0]
    layer.use_pass_z = layer.use_pass_object_index = layer.use_pass_material_index = True
    layer.cycles.denoising_store_passes = True
    layer.pass_alpha_threshold = 0.0
    scene.render.film_transparent = True
    scene.cycles.film_transparent_glass = True
    scene.cycles.pixel_filter_type, scene.cycles.filter_width = "BOX", 1.0
    scene.cycles.transparent_max_bounces = 16
    scene.cycles.use_adaptive_sampling = False
    scene.render.use_persistent_data = True
    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    if hasattr(settings, "use_exr_interleave"):
        settings.use_exr_interleave = True  # one part with all layers
    settings.color_depth, settings.exr_codec = "32", "NONE"


_CHANNELS = {
    "rgb": ("Combined.R", "Combined.G", "Combined.B"), "alpha": ("Combined.A",), "depth": ("Depth.Z", "Depth.V"),
    "albedo": ("Denoising Albedo.R", "Denoising Albedo.G", "Denoising Albedo.B"),
    "normal": ("Denoising Normal.X", "Denoising Normal.Y", "Denoising Normal.Z"),
    "moving": ("Object Index.X", "IndexOB.X", "Object Index.V"), "material": ("Material Index.X", "IndexMA.X", "Material Index.V"),
}  # fmt: skip
"""Pass -> its channels in the file of Blender, or the names of its single channel in several versions."""


def _rendered(scene: Any) -> dict[str, F32]:
    """Renders the picture; returns its passes, (H, W) or (H, W, 3), row 0 at the top."""
    with tempfile.TemporaryDirectory() as folder:
        scene.render.filepath = str(Path(folder) / "picture.exr")
        bpy.ops.render.render(write_still=True)
        pixels = read_exr(Path(scene.render.filepath))
    layer = scene.view_layers[0].name
    passes = {}
    for name, channels in _CHANNELS.items():
        found = [pixels[f"{layer}.{channel}"] for channel in channels if f"{layer}.{channel}" in pixels]
        wanted = 3 if name in ("rgb", "albedo", "normal") else 1
        if len(found) < wanted:
            raise GibsonSimError(
                f"Blender wrote no pass {name!r}; its channels are {', '.join(pixels)}; bpy 5.0.1 is known to work"
            )
        passes[name] = np.stack(found[:3], axis=2) if wanted == 3 else found[0]
    return passes


if __name__ == "__main__":
    main()
