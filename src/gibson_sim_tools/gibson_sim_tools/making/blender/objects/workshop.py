"""Models small objects in Blender: boxes with rounded edges, bodies of revolution, bars, and their materials.

Metres, z up. A ``LinkModel`` collects pieces and is written as one mesh in one GLB.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import bmesh
import bpy
from mathutils import Euler, Matrix, Vector

from gibson_sim.geometry.colours import linear_from_srgb

Point = Sequence[float]
Atlas = Mapping[str, tuple[float, float, float, float]]
"""Window of the picture, (left, top, right, bottom), fractions from the top left, for each side of a box (``+x`` to ``-z``)."""
_SHARP_ANGLE = math.radians(38.0)


@dataclass(frozen=True)
class ShaderMaterial:
    """A material of the Principled BSDF."""

    color: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """Base colour, sRGB, 0 to 1; a picture replaces it."""
    metallic: float = 0.0
    roughness: float = 0.5
    alpha: float = 1.0
    picture: str = ""
    """Name of a texture; empty = none."""
    tile: float = 0.0
    """Size of one repeat of the picture on boxes, m; 0 = mapped by an ``Atlas``, or around a body of revolution."""
    glow: float = 0.0
    """Strength of emission."""


class Workshop:
    """Blender's file in memory, with materials and pictures shared by links."""

    def __init__(self, pictures: Path) -> None:
        self.pictures = pictures
        self._materials: dict[ShaderMaterial, bpy.types.Material] = {}

    def clear(self) -> None:
        """Empties the file."""
        bpy.ops.wm.read_factory_settings(use_empty=True)
        self._materials.clear()

    def material(self, paint: ShaderMaterial) -> bpy.types.Material:
        """Returns Blender's material, created on first use."""
        if paint not in self._materials:
            material = bpy.data.materials.new(f"paint_{len(self._materials)}")
            material.use_nodes = True
            shader = material.node_tree.nodes["Principled BSDF"]
            color = (*linear_from_srgb(paint.color).tolist(), 1.0)
            shader.inputs["Base Color"].default_value = color
            shader.inputs["Metallic"].default_value = paint.metallic
            shader.inputs["Roughness"].default_value = paint.roughness
            shader.inputs["Alpha"].default_value = paint.alpha
            if paint.alpha < 1.0:
                material.surface_render_method = "BLENDED"
            image = None
            if paint.picture:
                image = material.node_tree.nodes.new("ShaderNodeTexImage")
                image.image = bpy.data.images.load(str(self.pictures / f"{paint.picture}.jpg"), check_existing=True)
                material.node_tree.links.new(image.outputs["Color"], shader.inputs["Base Color"])
            if paint.glow:
                shader.inputs["Emission Strength"].default_value = paint.glow
                shader.inputs["Emission Color"].default_value = color
                if image is not None:
                    material.node_tree.links.new(image.outputs["Color"], shader.inputs["Emission Color"])
            material.use_backface_culling = paint.alpha == 1.0
            self._materials[paint] = material
        return self._materials[paint]


class LinkModel:
    """Builds the mesh of one link."""

    def __init__(self, workshop: Workshop) -> None:
        self.workshop = workshop
        self.pieces: list[bpy.types.Object] = []

    def box(
        self,
        low: Point,
        high: Point,
        paint: ShaderMaterial,
        bevel: float = 0.003,
        segments: int = 2,
        atlas: Atlas | None = None,
        turn: Point = (0, 0, 0),
    ) -> bpy.types.Object:
        """Adds a box with rounded edges, rotated about its centre by ``turn`` (roll, pitch, yaw, radians)."""
        mesh = bmesh.new()
        size = [abs(b - a) for a, b in zip(low, high, strict=True)]
        bmesh.ops.create_cube(mesh, size=1.0, matrix=Matrix.Diagonal((*size, 1.0)))
        width = min(bevel, 0.45 * min(size))
        if width > 1e-5:
            bmesh.ops.bevel(
                mesh, geom=mesh.edges[:], offset=width, segments=segments, profile=0.5, affect="EDGES", clamp_overlap=True
            )
        _map_box_sides(mesh, size, paint.tile, atlas)
        middle = Vector([(a + b) / 2 for a, b in zip(low, high, strict=True)])
        return self._add_piece(mesh, paint, Matrix.Translation(middle) @ Euler(turn).to_matrix().to_4x4())

    def lathe(
        self,
        profile: Sequence[Point],
        paint: ShaderMaterial,
        sides: int = 28,
        at: Point = (0, 0, 0),
        turn: Point = (0, 0, 0),
        shape: Callable[[float, float], float] | None = None,
    ) -> bpy.types.Object:
        """Adds a body of revolution about z.

        Args:
            profile: radii and heights of the outline, metres, upwards on the outside (the normal is to its right); a radius of 0 closes it.
            paint: material; a picture wraps around once, its left edge at +x, its top at the top of the profile.
            sides: number of facets.
            at: position of its origin.
            turn: roll, pitch, yaw about the origin, radians.
            shape: factor of the radius at (angle, fraction of the outline), for bodies that are not quite round.
        """
        mesh = bmesh.new()
        uv = mesh.loops.layers.uv.new("UVMap")
        lengths = [0.0]
        for (r0, z0), (r1, z1) in itertools.pairwise(profile):
            lengths.append(lengths[-1] + math.hypot(r1 - r0, z1 - z0))
        rings = []
        for k, (radius, z) in enumerate(profile):
            share = lengths[k] / lengths[-1]
            if radius < 1e-6:
                rings.append([mesh.verts.new((0.0, 0.0, z))])
                continue
            ring = []
            for j in range(sides):
                angle = 2 * math.pi * j / sides
                r = radius * (shape(angle, share) if shape else 1.0)
                ring.append(mesh.verts.new((r * math.cos(angle), r * math.sin(angle), z)))
            rings.append(ring)
        for k, (low, high) in enumerate(itertools.pairwise(rings)):
            if len(low) == len(high) == 1:
                continue
            for j in range(sides):
                n = (j + 1) % sides
                corners: list[tuple[bmesh.types.BMVert, float, int]] = []
                if len(low) > 1:
                    corners += [(low[j], j, k), (low[n], j + 1, k)]
                else:
                    corners += [(low[0], j + 0.5, k)]
                corners += [(high[n], j + 1, k + 1), (high[j], j, k + 1)] if len(high) > 1 else [(high[0], j + 0.5, k + 1)]
                face = mesh.faces.new([corner[0] for corner in corners])
                for loop, (_, a, level) in zip(face.loops, corners, strict=True):
                    loop[uv].uv = (a / sides, lengths[level] / lengths[-1])
        return self._add_piece(mesh, paint, Matrix.Translation(Vector(at)) @ Euler(turn).to_matrix().to_4x4())

    def disc(self, radius: float, paint: ShaderMaterial, at: Point, turn: Point, sides: int = 44) -> bpy.types.Object:
        """Adds a flat disc with a picture facing z; before the rotation, its right is +y and its top -x."""
        piece = self.lathe([(radius, 0.0), (0.0, 0.0)], paint, sides, at, turn)
        for loop, place in zip(piece.data.loops, piece.data.uv_layers[0].data, strict=True):
            x, y, _ = piece.data.vertices[loop.vertex_index].co
            place.uv = (0.5 + y / (2 * radius), 0.5 - x / (2 * radius))
        return piece

    def rod(
        self, low: Point, high: Point, radius: float, paint: ShaderMaterial, sides: int = 16, bevel: float = 0.0, top: float = 0.0
    ) -> bpy.types.Object:
        """Adds a round bar between two points. ``top``: radius at its end, m; 0 = ``radius``."""
        start, end = Vector(low), Vector(high)
        length, last = (end - start).length, top or radius
        b = min(bevel, 0.4 * radius, 0.4 * length)
        profile = [(0.0, 0.0), (radius - b, 0.0), (radius, b), (last, length - b), (last - b, length), (0.0, length)]
        if b == 0.0:
            profile = [(0.0, 0.0), (radius, 0.0), (last, length), (0.0, length)]
        piece = self.lathe(profile, paint, sides)
        quat = Vector((0, 0, 1)).rotation_difference(end - start)
        piece.matrix_world = Matrix.Translation(start) @ quat.to_matrix().to_4x4()
        return piece

    def tube(
        self,
        points: Sequence[Point],
        radius: float,
        paint: ShaderMaterial,
        resolution: int = 3,
        steps: int = 6,
        radii: Sequence[float] = (),
    ) -> bpy.types.Object:
        """Adds a smooth curved bar along points. ``radii``: factor of the radius at each point."""
        curve = bpy.data.curves.new("tube", "CURVE")
        curve.dimensions, curve.bevel_depth, curve.bevel_resolution, curve.resolution_u, curve.use_fill_caps = (
            "3D",
            radius,
            resolution,
            steps,
            True,
        )
        spline = curve.splines.new("NURBS")
        spline.points.add(len(points) - 1)
        for k, (point, place) in enumerate(zip(spline.points, points, strict=True)):
            point.co, point.radius = (*place, 1.0), radii[k] if radii else 1.0
        spline.use_endpoint_u, spline.order_u = True, min(4, len(points))
        curve_object = bpy.data.objects.new("tube", curve)
        bpy.context.scene.collection.objects.link(curve_object)
        mesh_data = bpy.data.meshes.new_from_object(curve_object.evaluated_get(bpy.context.evaluated_depsgraph_get()))
        bpy.data.objects.remove(curve_object)
        mesh = bmesh.new()
        mesh.from_mesh(mesh_data)
        return self._add_piece(mesh, paint, Matrix.Identity(4))

    def prism(
        self, outline: Sequence[Point], low: float, high: float, paint: ShaderMaterial, bevel: float = 0.002, axis: str = "z"
    ) -> bpy.types.Object:
        """Adds a counter-clockwise outline extruded along an axis: in the plane (x, y) for z, (y, z) for x, (z, x) for y."""
        mesh = bmesh.new()
        face = mesh.faces.new([mesh.verts.new((a, b, low)) for a, b in outline])
        extruded = bmesh.ops.extrude_face_region(mesh, geom=[face])["geom"]
        bmesh.ops.translate(mesh, verts=[v for v in extruded if isinstance(v, bmesh.types.BMVert)], vec=(0, 0, high - low))
        bmesh.ops.recalc_face_normals(mesh, faces=mesh.faces[:])
        if bevel:
            edges = [e for e in mesh.edges if e.calc_face_angle(0.0) > 0.5]
            bmesh.ops.bevel(mesh, geom=edges, offset=bevel, segments=2, profile=0.5, affect="EDGES", clamp_overlap=True)
        size = [1.0, 1.0, 1.0]
        _map_box_sides(mesh, size, paint.tile or 1.0, None)
        turn = {
            "z": Matrix.Identity(4),
            "x": Matrix(((0, 0, 1, 0), (1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 0, 1))),
            "y": Matrix(((0, 1, 0, 0), (0, 0, 1, 0), (1, 0, 0, 0), (0, 0, 0, 1))),
        }[axis]
        return self._add_piece(mesh, paint, turn)

    def plate(self, corners: Sequence[Point], paint: ShaderMaterial) -> bpy.types.Object:
        """Adds a flat quad that shows the whole picture. ``corners``: top left, bottom left, bottom right, top right, seen from the front."""
        mesh = bmesh.new()
        uv = mesh.loops.layers.uv.new("UVMap")
        face = mesh.faces.new([mesh.verts.new(corner) for corner in corners])
        for loop, place in zip(face.loops, ((0, 1), (0, 0), (1, 0), (1, 1)), strict=True):
            loop[uv].uv = place
        return self._add_piece(mesh, paint, Matrix.Identity(4))

    def write(self, path: Path, keep_flat: bool = False) -> int:
        """Writes the GLB and returns its number of triangles."""
        for piece in self.pieces:
            piece.data.transform(piece.matrix_world)
            piece.matrix_world = Matrix.Identity(4)
            # A mirroring matrix flips the surfaces.
            piece.data.update()
        bpy.ops.object.select_all(action="DESELECT")
        for piece in self.pieces:
            piece.select_set(True)
        bpy.context.view_layer.objects.active = self.pieces[0]
        if len(self.pieces) > 1:
            bpy.ops.object.join()
        mesh_object = bpy.context.view_layer.objects.active
        mesh_object.name = mesh_object.data.name = path.stem
        for polygon in mesh_object.data.polygons:
            polygon.use_smooth = not keep_flat
        mesh_object.data.set_sharp_from_angle(angle=_SHARP_ANGLE)
        # Weighted normals keep flat sides flat beside rounded edges.
        modifier = mesh_object.modifiers.new("weigh", "WEIGHTED_NORMAL")
        modifier.keep_sharp, modifier.weight = True, 60
        bpy.ops.export_scene.gltf(
            filepath=str(path),
            export_format="GLB",
            use_selection=True,
            export_apply=True,
            export_yup=True,
            export_animations=False,
            export_image_format="AUTO",
            export_skins=False,
            export_morph=False,
            export_cameras=False,
            export_lights=False,
            export_tangents=False,
        )
        mesh_object.data.calc_loop_triangles()
        count = len(mesh_object.data.loop_triangles)
        bpy.data.objects.remove(mesh_object)
        self.pieces.clear()
        return count

    def _add_piece(self, mesh: bmesh.types.BMesh, paint: ShaderMaterial, matrix: Matrix) -> bpy.types.Object:
        data = bpy.data.meshes.new("piece")
        mesh.to_mesh(data)
        mesh.free()
        data.materials.clear()
        data.materials.append(self.workshop.material(paint))
        if not data.uv_layers:
            data.uv_layers.new(name="UVMap")
        elif data.uv_layers[0].name != "UVMap":
            data.uv_layers[0].name = "UVMap"
        piece = bpy.data.objects.new("piece", data)
        piece.matrix_world = matrix
        bpy.context.scene.collection.objects.link(piece)
        self.pieces.append(piece)
        return piece


def mm(text: str) -> list[tuple[float, ...]]:
    """Parses points in millimetres; returns metres: ``"12 0, 13.5 4"`` gives ``[(0.012, 0.0), (0.0135, 0.004)]``."""
    return [tuple(float(number) / 1000 for number in place.split()) for place in text.split(",")]


def _map_box_sides(mesh: bmesh.types.BMesh, size: Sequence[float], tile: float, atlas: Atlas | None) -> None:
    """Maps a picture onto faces by their side: by the atlas, or repeated, with u along the longest edge."""
    uv = mesh.loops.layers.uv.new("UVMap")
    mesh.normal_update()
    extents = [max(v.co[k] for v in mesh.verts) - min(v.co[k] for v in mesh.verts) for k in range(3)]
    for face in mesh.faces:
        axis = max(range(3), key=lambda k: abs(face.normal[k]))
        side = ("+" if face.normal[axis] > 0 else "-") + "xyz"[axis]
        for loop in face.loops:
            co = loop.vert.co
            if atlas is not None:
                loop[uv].uv = _atlas_uv(co, side, size, atlas.get(side, (0.0, 0.0, 0.001, 0.001)))
                continue
            others = [k for k in range(3) if k != axis]
            along = max(others, key=lambda k: extents[k])
            across = next(k for k in others if k != along)
            loop[uv].uv = (co[along] / (tile or 1.0), co[across] / (tile or 1.0) + 0.37 * axis)


def _atlas_uv(co: Vector, side: str, size: Sequence[float], window: tuple[float, float, float, float]) -> tuple[float, float]:
    """Returns the texture coordinates of a point on a side, seen from outside with z up; seen from above, +x is at the bottom."""
    x, y, z = (co[k] / size[k] + 0.5 for k in range(3))
    right, up = {
        "+x": (y, z),
        "-x": (1 - y, z),
        "+y": (1 - x, z),
        "-y": (x, z),
        "+z": (y, 1 - x),
        "-z": (1 - y, 1 - x),
    }[side]
    left, top, end, bottom = window
    return left + right * (end - left), 1.0 - (bottom + up * (top - bottom))


STEEL = ShaderMaterial((0.72, 0.73, 0.75), metallic=0.55, roughness=0.32)
TIN = ShaderMaterial((0.80, 0.81, 0.82), metallic=0.5, roughness=0.3)
BRASS = ShaderMaterial((0.72, 0.58, 0.32), metallic=0.5, roughness=0.35)
DARK_STEEL = ShaderMaterial((0.30, 0.31, 0.33), metallic=0.4, roughness=0.4)
BLACK = ShaderMaterial((0.07, 0.07, 0.08), roughness=0.45)
RUBBER = ShaderMaterial((0.13, 0.13, 0.14), roughness=0.8)
WHITE = ShaderMaterial((0.93, 0.93, 0.91), roughness=0.35)
PORCELAIN = ShaderMaterial((0.95, 0.945, 0.92), roughness=0.15)
PAPER = ShaderMaterial((0.93, 0.90, 0.83), roughness=0.9)
LACQUER = ShaderMaterial((0.92, 0.915, 0.89), roughness=0.4)
GREY_PLASTIC = ShaderMaterial((0.52, 0.53, 0.55), roughness=0.5)
OAK = ShaderMaterial((0.72, 0.56, 0.38), roughness=0.55, picture="wood_oak", tile=0.5)
WALNUT = ShaderMaterial((0.40, 0.27, 0.17), roughness=0.5, picture="wood_walnut", tile=0.5)
BEECH = ShaderMaterial((0.84, 0.70, 0.52), roughness=0.55, picture="wood_beech", tile=0.5)
GLASS = ShaderMaterial((0.86, 0.93, 0.94), roughness=0.05, alpha=0.28)
PANE = ShaderMaterial((0.72, 0.84, 0.88), roughness=0.05, alpha=0.18)


def label(picture: str, roughness: float = 0.45, metallic: float = 0.0) -> ShaderMaterial:
    """Returns a material with a picture."""
    return ShaderMaterial(picture=picture, roughness=roughness, metallic=metallic)
