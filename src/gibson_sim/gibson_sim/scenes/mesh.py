"""Reads meshes and makes primitives: the one place that turns a ``Shape`` into triangles, for drawing, maps and physics alike.

A ``MeshLoader`` reads each file and decodes each image once for as long as it lives; nothing is kept globally.
"""

from __future__ import annotations

import json
import os
import struct
import sys
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import MeshError, TextError
from gibson_sim.geometry.transforms import matrix_from_pose, transform_points
from gibson_sim.quoting import quoted
from gibson_sim.reading import read_file
from gibson_sim.robots.spec import Shape
from gibson_sim.scenes.file_roots import bounded, is_inside, package_roots
from gibson_sim.scenes.mesh_dae import load_dae
from gibson_sim.scenes.mesh_gltf import load_gltf
from gibson_sim.scenes.mesh_obj import load_obj
from gibson_sim.scenes.mesh_ply import load_ply
from gibson_sim.scenes.mesh_stl import load_stl
from gibson_sim.scenes.mesh_types import LIGHT_GREY, Material, Mesh, MeshPart, TextureSource, UpAxis, merge
from gibson_sim.scenes.primitives import primitive_mesh
from gibson_sim.scenes.spec import CollisionSpec, SceneSpec
from gibson_sim.scenes.textures import Decode, TextureStore

__all__ = [
    "LIGHT_GREY", "MESH_SUFFIXES", "Material", "Mesh", "MeshLoader", "MeshPart", "TextureSource",
    "collision_triangles", "load_mesh", "load_shape", "primitive_mesh", "shape_triangles",
]  # fmt: skip

MESH_SUFFIXES = (".glb", ".gltf", ".obj", ".dae", ".stl", ".ply")
"""Formats that can be read, lower case."""


class MeshLoader:
    """Reads meshes, each file once.

    Args:
        allowed_roots: folders that meshes must lie in, symbolic links followed; None = anywhere. Textures, materials and buffers that a
            mesh names must lie in these folders or in its own package (``file_roots``), wherever the mesh lies.
        textures: False = geometry only: textures are looked for, and warned about, but not decoded; "sizes" = black images of the
            right size.
        max_bytes: a larger mesh file is refused; None = any size.
        max_parts: a glTF with more meshes in its nodes is refused; None = any number.
    """

    def __init__(
        self,
        allowed_roots: Sequence[Path] | None,
        *,
        textures: Decode = True,
        max_bytes: int | None = None,
        max_parts: int | None = None,
    ) -> None:
        self.roots = None if allowed_roots is None else tuple(allowed_roots)
        self.max_bytes = max_bytes
        self.max_parts = max_parts
        self._textures = TextureStore((), textures)
        self._meshes: dict[Path, Mesh] = {}

    def mesh(self, path: Path) -> Mesh:
        """Returns the mesh in a file, in its own frame, z up, metres.

        Raises:
            MeshError: the file is missing, outside the allowed folders, of an unknown format or broken.
        """
        real = Path(os.path.realpath(path))
        if real not in self._meshes:
            self._meshes[real] = self._read(Path(path), real)
        return self._meshes[real]

    def image_bytes(self, texture: TextureSource) -> bytes:
        """Returns the image file of a texture of a mesh from here; the loader's ``textures`` must be "sizes"."""
        return self._textures.encoded(texture)

    def shape(self, shape: Shape) -> Mesh:
        """Returns the triangles of a shape: its mesh file under its scale, or the primitive."""
        if shape.kind != "mesh":
            return primitive_mesh(shape)
        mesh = self.mesh(Path(shape.mesh))
        if tuple(shape.size) == (1.0, 1.0, 1.0):
            return mesh
        if not (np.isfinite(shape.size).all() and all(shape.size)):
            raise MeshError(f"{shape.mesh}: scale is {tuple(shape.size)}, the three factors must be finite and not 0")
        return mesh.transformed(np.diag([*shape.size, 1.0]))

    def _read(self, path: Path, real: Path) -> Mesh:
        if self.roots is not None and not is_inside(real, self.roots):
            raise MeshError(f"{path}: lies outside {', '.join(map(str, self.roots))}; move it into the scene's folder")
        try:
            data = read_file(real, self.max_bytes or sys.maxsize - 1)
        except OSError as e:
            raise MeshError(f"{path}: cannot be read: {e.strerror or e}") from e
        if not data:
            raise MeshError(f"{path}: the file is empty")
        try:
            mesh = self._parse(path, real, data)
        except MeshError:
            raise
        except TextError as e:
            raise MeshError(f"{path}: {e}").telling(e.public) from e
        # A broken file makes any of these fly out of a parser; all mean the same to the user.
        except (
            ValueError, KeyError, IndexError, TypeError, AttributeError, OverflowError, RecursionError, MemoryError,
            OSError, struct.error, json.JSONDecodeError,
        ) as e:  # fmt: skip
            raise MeshError(f"{path}: is not a readable {path.suffix.lower()} file: {type(e).__name__}: {_one_line(e)}") from e
        if not mesh.parts:
            raise MeshError(f"{path}: has no triangles")
        return mesh

    def _parse(self, path: Path, real: Path, data: bytes) -> Mesh:
        suffix = path.suffix.lower()
        warnings: list[str] = []
        files = [real]
        textures = self._textures.within(bounded((*package_roots(path), *(self.roots or ()))))

        def warn(text: str) -> None:
            if text not in warnings:
                warnings.append(text)

        up_axis: UpAxis = "z"
        unit_m = 1.0
        if suffix in (".glb", ".gltf"):
            parts = load_gltf(path, data, textures, files, warn, self.max_parts)
            up_axis = "y"
        elif suffix == ".obj":
            parts = load_obj(path, data, textures, files, warn)
        elif suffix == ".dae":
            parts, up_axis, unit_m = load_dae(path, data, textures, files, warn)
        elif suffix == ".stl":
            parts = load_stl(path, data)
        elif suffix == ".ply":
            parts = load_ply(path, data, textures, files, warn)
        else:
            raise MeshError(
                f"{path}: {quoted(suffix or 'no suffix')} is not a mesh format that can be read; known: {', '.join(MESH_SUFFIXES)}"
            )
        return Mesh(tuple(parts), tuple(warnings), tuple(files), up_axis, unit_m)


def load_mesh(path: Path, allowed_roots: Sequence[Path]) -> Mesh:
    """Returns the mesh in a glTF, GLB, OBJ, DAE, STL or PLY file, z up, metres. For several files use one ``MeshLoader``."""
    return MeshLoader(allowed_roots).mesh(path)


def load_shape(shape: Shape, allowed_roots: Sequence[Path] | None = None) -> Mesh:
    """Returns the triangles of a shape. For several shapes use one ``MeshLoader``. No ``allowed_roots``: the mesh was checked already."""
    return MeshLoader(mesh_folders([shape]) if allowed_roots is None else allowed_roots).shape(shape)


def scene_roots(scene: SceneSpec) -> tuple[Path, ...]:
    """Returns the folders that meshes of the scene may lie in, for a ``MeshLoader``.

    Whoever loaded the scene has checked each path already, so the folders of the shapes themselves are among them.
    """
    return (scene.root, *mesh_folders([v.shape for v in scene.visuals] + [c.shape for c in scene.collisions]))


def mesh_folders(shapes: Iterable[Shape]) -> tuple[Path, ...]:
    """Returns the folders that hold the mesh files of shapes, for a ``MeshLoader`` of files that were checked already.

    Where a file is a link, as in an installation that is made of links, these are the link's folder and the one that it leads to.
    """
    files = {Path(shape.mesh) for shape in shapes if shape.kind == "mesh"}
    return tuple(sorted({folder for file in files for folder in (file.parent, Path(os.path.realpath(file)).parent)}))


def shape_triangles(loader: MeshLoader, collision: CollisionSpec) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Returns one collision shape in the world frame: vertices (V, 3), triangles (F, 3)."""
    vertices, triangles = loader.shape(collision.shape).merged()
    return transform_points(matrix_from_pose(collision.pose), vertices), triangles


def collision_triangles(scene: SceneSpec, loader: MeshLoader | None = None) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Returns all static collision shapes as one mesh in the world frame: vertices (V, 3), triangles (F, 3)."""
    used = loader or MeshLoader(scene_roots(scene), textures=False)
    return merge([shape_triangles(used, collision) for collision in scene.collisions])


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split())[:200]
