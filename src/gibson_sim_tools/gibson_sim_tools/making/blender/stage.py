"""Builds a building as a Blender scene: meshes with the tiles of their surfaces, and lights. ``bake`` bakes it, ``trace`` traces it."""

from __future__ import annotations

from typing import Any

import bpy
import mathutils
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.colours import linear_from_srgb
from gibson_sim_tools.making.blender.assembly import NO_ATLAS, Assembly
from gibson_sim_tools.making.blender.materials import plain_material, tile_material
from gibson_sim_tools.making.blender.shapes import F64, I64
from gibson_sim_tools.making.building import Building, Lamp, Opening, Room, Storey, Wall
from gibson_sim_tools.making.tiles import PATTERNS, Tile, TileName, draw_tile, factors_of, tiles_of

_SKY = (0.80, 0.90, 1.0)
_SKY_WATTS = 2.6
"""Power of the sky per floor area at strength 1, W/m^2: all rooms appear equally bright, as to an adapted eye."""
_SUN_FACTOR, _LAMP_FACTOR = 3.4, 0.3
"""Factors for the strength of sun and lamps in the plan."""
_FILL_WATTS = 0.35
"""Power of the fill light under the ceiling of a room per floor area, W/m^2."""
_WINDOWLESS_FACTOR = 4.5
"""Factor of the fill light in rooms without windows."""
_SMOOTH_ANGLE = np.radians(42.0)
"""Angle between faces above which an edge is sharp, radians."""


def new_scene(seed: int) -> Any:
    """Returns Blender's scene, empty, with the settings of Cycles that all pictures share. ``seed``: of the sampling."""
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    scene.render.engine = "CYCLES"
    cycles = scene.cycles
    cycles.device, cycles.seed, cycles.use_denoising = "CPU", seed % 2**31, False
    cycles.max_bounces, cycles.diffuse_bounces, cycles.caustics_reflective = 5, 5, False
    cycles.sample_clamp_indirect = 8.0
    return scene


class Stage:
    """A building as a Blender scene. Blender's state is global, so only one stage can exist at a time.

    Args:
        building: its lights.
        assembly: its triangles. Glass is left out: light passes through it.
    """

    def __init__(self, building: Building, assembly: Assembly) -> None:
        self.scene = new_scene(building.seed)
        self.materials: dict[str | TileName, tuple[Any, Any]] = {
            name: plain_material(name) for name in assembly.patterns if name not in PATTERNS and name != "glass"
        }
        """Tile, or pattern without a tile -> its material, and the node whose image is the target of a bake."""
        self.objects: dict[int, Any] = {}
        """Index of a light map -> the object with its surfaces."""
        self._tiles: dict[TileName, Tile] = {}
        self._add_meshes(assembly)
        self._add_lights(building)

    def _add_meshes(self, assembly: Assembly) -> None:
        glow = _has_pattern(assembly, "glow")
        for atlas in sorted(set(assembly.atlas.tolist())):
            rows = surfaces_of(assembly, atlas)
            if len(rows):
                self.objects[atlas] = self.mesh_object(assembly, rows, "rest" if atlas == NO_ATLAS else f"atlas_{atlas}")
        if glow.any():
            # Glowing surfaces only depict lamps; the light comes from light sources, which they must not occlude.
            glow_object = self.mesh_object(assembly, np.flatnonzero(glow), "glow")
            glow_object.visible_shadow = glow_object.visible_diffuse = False

    def mesh_object(self, assembly: Assembly, rows: I64, name: str) -> Any:
        """Adds an object with the triangles ``rows`` of an assembly to the scene; returns it."""
        corners = assembly.corners[rows].reshape(-1, 3)
        # Merge coincident corners of each object for smooth shading.
        keys = np.column_stack([np.round(corners, 5), np.repeat(assembly.owner[rows], 3)])
        _, first, index = np.unique(keys, axis=0, return_index=True, return_inverse=True)
        triangles = np.asarray(index).reshape(-1, 3)
        mesh = bpy.data.meshes.new(name)
        mesh.vertices.add(len(first))
        mesh.vertices.foreach_set("co", corners[first].astype(np.float32).ravel())
        mesh.loops.add(triangles.size)
        mesh.loops.foreach_set("vertex_index", triangles.ravel().astype(np.int32))
        mesh.polygons.add(len(triangles))
        mesh.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
        keys_of_rows, coords, factors = self._appearances(assembly, rows)
        slots = sorted(set(keys_of_rows), key=str)
        for slot in slots:
            mesh.materials.append(self.materials[slot][0])
        mesh.update()
        numbers = {slot: k for k, slot in enumerate(slots)}
        mesh.polygons.foreach_set("material_index", np.array([numbers[k] for k in keys_of_rows], dtype=np.int32))
        mesh.polygons.foreach_set("use_smooth", np.ones(len(triangles), dtype=bool))
        for attribute, values in (("tile", coords), ("factor", np.repeat(factors, 3, axis=0))):
            corner_values = mesh.attributes.new(attribute, "FLOAT_VECTOR", "CORNER")
            corner_values.data.foreach_set("vector", values.astype(np.float32).ravel())
        mesh.set_sharp_from_angle(angle=_SMOOTH_ANGLE)
        mesh_object = bpy.data.objects.new(name, mesh)
        self.scene.collection.objects.link(mesh_object)
        return mesh_object

    def _appearances(self, assembly: Assembly, rows: I64) -> tuple[list[str | TileName], F64, F64]:
        """Returns the material, the tile coordinates, (F, 3, 3), and the linear factor of the colour, (F, 3), of triangles."""
        pattern, tint, place = assembly.pattern[rows], assembly.tint[rows], assembly.pattern_coords[rows]
        names, index = tiles_of(assembly.patterns, pattern, tint, place)
        materials: list[str | TileName] = [assembly.patterns[p] for p in pattern]
        coords, factors = np.zeros_like(place), np.asarray(linear_from_srgb(tint))
        for number, name in enumerate(names):
            if name not in self._tiles:
                self._tiles[name] = draw_tile(name)
                self.materials[name] = tile_material(name.file, self._tiles[name])
            tile = self._tiles[name]
            covered = np.flatnonzero(index == number)
            for k in covered.tolist():
                materials[k] = name
            coords[covered, :, :2] = tile.coords(place[covered])
            factors[covered] = factors_of(tile, name.pattern, tint[covered])
        return materials, coords, factors

    def _add_lights(self, building: Building) -> None:
        world = bpy.data.worlds.new("sky")
        world.use_nodes = True
        world.node_tree.nodes["Background"].inputs[0].default_value = (*_SKY, 1.0)
        world.node_tree.nodes["Background"].inputs[1].default_value = 0.0
        self.scene.world = world
        sun = self._add_light("SUN", _SUN_FACTOR * building.sun, (1.0, 0.95, 0.86))
        sun.data.angle = np.radians(0.6)
        sun.rotation_euler = mathutils.Vector(building.sun_direction).to_track_quat("-Z", "Y").to_euler()
        for storey in building.storeys:
            for room in storey.rooms:
                self._light_room(room, storey, building.sky)
        for lamp in building.lamps:
            self._light_lamp(lamp)

    def _add_light(self, kind: str, power: float, color: tuple[float, float, float]) -> Any:
        data = bpy.data.lights.new(kind.lower(), kind)
        data.energy, data.color = power, color
        light_object = bpy.data.objects.new(kind.lower(), data)
        self.scene.collection.objects.link(light_object)
        return light_object

    def _light_room(self, room: Room, storey: Storey, sky: float) -> None:
        """Adds a sky light in every window of a room, and a fill light under its ceiling."""
        corners = np.asarray(room.corners, dtype=float)
        x, y = corners.T
        area = abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2
        windows = [(w, o) for w in storey.walls if room.name in (w.left, w.right) for o in w.openings if o.kind == "window"]
        for wall, opening in windows:
            share = opening.width * opening.height / sum(o.width * o.height for _, o in windows)
            self._light_window(wall, opening, storey.floor_z, _SKY_WATTS * sky * area * share)
        light = self._add_light("AREA", _FILL_WATTS * area * (1.0 if windows else _WINDOWLESS_FACTOR), (1.0, 0.97, 0.93))
        low, high = corners.min(axis=0), corners.max(axis=0)
        light.data.shape, light.data.size, light.data.size_y = "RECTANGLE", *(float(v) for v in 0.7 * (high - low))
        light.location = (*((low + high) / 2), storey.floor_z + storey.height - 0.15)

    def _light_window(self, wall: Wall, opening: Opening, floor_z: float, watts: float) -> None:
        """Adds an area light at the outer face of a window."""
        u = np.subtract(wall.end, wall.start) / np.linalg.norm(np.subtract(wall.end, wall.start))
        inward = np.array([-u[1], u[0]]) * (1.0 if wall.left else -1.0)
        light = self._add_light("AREA", watts, _SKY)
        light.data.shape, light.data.size, light.data.size_y = "RECTANGLE", opening.width, opening.height
        middle = np.asarray(wall.start) + u * opening.middle - inward * (wall.thickness / 2 - 0.012)
        light.location = (*middle, floor_z + opening.sill + opening.height / 2)
        light.rotation_euler = mathutils.Vector((*inward, 0.0)).to_track_quat("-Z", "Z").to_euler()

    def _light_lamp(self, lamp: Lamp) -> None:
        color, power = _lamp_color(lamp.temperature), _LAMP_FACTOR * lamp.power
        if lamp.kind == "panel":
            light = self._add_light("AREA", power, color)
            light.data.size = lamp.size
        elif lamp.kind == "spot":
            light = self._add_light("SPOT", power, color)
            light.data.spot_size, light.data.spot_blend, light.data.shadow_soft_size = np.radians(80), 0.6, 0.03
        else:
            light = self._add_light("POINT", power, color)
            light.data.shadow_soft_size = min(lamp.size / 2, 0.12)
        light.location = lamp.position


def surfaces_of(assembly: Assembly, atlas: int) -> I64:
    """Returns the indices of the triangles of a light map that reflect light; ``NO_ATLAS``: those without a light map."""
    return np.flatnonzero((assembly.atlas == atlas) & ~_has_pattern(assembly, "glow") & ~_has_pattern(assembly, "glass"))


def _has_pattern(assembly: Assembly, name: str) -> NDArray[np.bool_]:
    return np.array([p == name for p in assembly.patterns])[assembly.pattern]


def _lamp_color(kelvin: float) -> tuple[float, float, float]:
    """Returns the linear colour of a lamp as seen by an eye that is half adapted to it."""
    warm = np.clip((6500.0 - kelvin) / 4000.0, -0.5, 1.0)
    return (1.0, float(1.0 - 0.24 * warm), float(1.0 - 0.55 * warm))
