"""Reads USD with ``usd-core``, an optional dependency: meshes, texture coordinates, colours and UsdPreviewSurface textures."""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import EnvironmentProblemError, MeshError, SceneError
from gibson_sim.formats.file_roots import is_inside
from gibson_sim.formats.mesh import TO_Z_UP, Material, Mesh, MeshPart, UpAxis, build_part, index_corners
from gibson_sim.formats.polygons import triangulate
from gibson_sim.formats.textures import TextureStore
from gibson_sim.geometry.colours import srgb8_from_linear, srgb_from_linear
from gibson_sim_tools.importing.document import ImportedObject
from gibson_sim_tools.importing.labels import class_name

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_UP: dict[str, UpAxis] = {"Y": "y", "Z": "z"}
_MAX_MESHES = 20_000


def require_usd() -> None:
    """Checks that ``usd-core`` is installed.

    Raises:
        EnvironmentProblemError: it is not; the message says how to install it.
    """
    if importlib.util.find_spec("pxr") is None:
        raise EnvironmentProblemError("reading USD files needs usd-core, which is not installed: pip install usd-core")


def read_usd(path: Path, up_axis: UpAxis | None, unit_m: float | None) -> tuple[list[ImportedObject], list[str]]:
    """Returns the meshes of a stage, z up, metres, and warnings.

    Args:
        path: the file.
        up_axis: up axis of the file; None = as the file says.
        unit_m: metres per unit; None = as the file says.

    Raises:
        EnvironmentProblemError: usd-core is not installed.
        SceneError: the file is damaged or has no meshes.
    """
    require_usd()
    from pxr import Tf, Usd

    try:
        stage = Usd.Stage.Open(str(path))
    except Tf.ErrorException as e:
        raise SceneError(f"{path}: cannot be read: {' '.join(str(e).split())[:200]}") from e
    for layer in stage.GetUsedLayers():
        if layer.realPath and not layer.anonymous and not is_inside(Path(layer.realPath.split("[")[0]), (path.parent,)):
            raise SceneError(f"{path}: refers to {layer.realPath}, outside its folder; put all its files into one folder")
    reader = _Stage(path, stage, up_axis, unit_m)
    objects = list(reader.objects())
    if not objects:
        raise SceneError(f"{path}: has no meshes; are its payloads and references beside it?")
    return objects, reader.warnings


class _Stage:
    """Reads the meshes of one stage."""

    def __init__(self, path: Path, stage: Any, up_axis: UpAxis | None, unit_m: float | None) -> None:
        from pxr import UsdGeom

        self._path, self._stage = path, stage
        self.warnings: list[str] = []
        self._textures = TextureStore((path.parent,))
        self._files: list[Path] = []
        self._xforms = UsdGeom.XformCache()
        up = up_axis or _UP.get(str(UsdGeom.GetStageUpAxis(stage)), "y")
        self._to_world = np.eye(4)
        self._to_world[:3, :3] = TO_Z_UP[up] * (unit_m or float(UsdGeom.GetStageMetersPerUnit(stage)))
        self._materials: dict[str, Material] = {}

    def objects(self) -> Iterator[ImportedObject]:
        from pxr import Usd, UsdGeom

        count = 0
        for prim in self._stage.Traverse(Usd.TraverseInstanceProxies()):
            if not prim.IsA(UsdGeom.Mesh) or UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible:
                continue
            if UsdGeom.Imageable(prim).ComputePurpose() not in (UsdGeom.Tokens.default_, UsdGeom.Tokens.render):
                continue
            count += 1
            if count > _MAX_MESHES:
                raise SceneError(f"{self._path}: has more than {_MAX_MESHES} meshes; export a part of it, or join meshes")
            parts = self._parts(prim)
            if parts:
                name = "_".join(str(prim.GetPath()).strip("/").split("/")[-2:])
                yield ImportedObject(name, Mesh(tuple(parts)), semantic_class=_semantic_class(prim))

    def _parts(self, prim: Any) -> list[MeshPart]:
        from pxr import UsdGeom, UsdShade

        mesh = UsdGeom.Mesh(prim)
        points = _array(mesh.GetPointsAttr().Get(), 3)
        sizes, corners = (
            np.asarray(a.Get() or [], dtype=np.int64) for a in (mesh.GetFaceVertexCountsAttr(), mesh.GetFaceVertexIndicesAttr())
        )
        if not len(points) or not len(corners):
            return []
        if sizes.sum() != len(corners) or corners.min() < 0 or corners.max() >= len(points):
            raise MeshError(f"{self._path}: faces of {prim.GetPath()} do not fit its {len(points)} points; the file is damaged")
        matrix = self._to_world @ np.asarray(self._xforms.GetLocalToWorldTransform(prim), dtype=np.float64).T
        uvs = self._primvar(prim, ("st", "UVMap", "st0", "map1"), corners, sizes, 2)
        colors = self._primvar(prim, ("displayColor",), corners, sizes, 3)
        triangles, polygon = triangulate(points, corners, sizes)
        if str(mesh.GetOrientationAttr().Get()) == "leftHanded":
            triangles = triangles[:, ::-1]
        bound = np.zeros(len(sizes), dtype=np.int64)
        materials = [UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()[0]]
        for subset in UsdGeom.Subset.GetAllGeomSubsets(mesh):
            materials.append(UsdShade.MaterialBindingAPI(subset.GetPrim()).ComputeBoundMaterial()[0])
            bound[np.asarray(subset.GetIndicesAttr().Get() or [], dtype=np.int64)] = len(materials) - 1
        parts = []
        for k, material in enumerate(materials):
            part_triangles = triangles[bound[polygon] == k]
            part = self._part(prim, points, corners, part_triangles, uvs, colors, self._material(material), matrix)
            if part is not None:
                parts.append(part)
        return parts

    def _part(
        self, prim: Any, points: F64, corners: I64, triangles: I64, uvs: F64 | None, colors: F64 | None, material: Material | None,
        matrix: F64,
    ) -> MeshPart | None:  # fmt: skip
        if not len(triangles):
            return None
        rows = triangles.ravel()
        columns = [corners[rows]]
        for values, steps in ((uvs, 65536.0), (colors, 255.0)):
            if values is not None:
                columns += list(np.rint(np.clip(values[rows], -1e4, 1e4) * steps).astype(np.int64).T)
        first, inverse = index_corners(*columns)
        corner_rows = rows[first]
        tints = None if colors is None or material is not None else srgb8_from_linear(colors[corner_rows])
        if uvs is not None:
            uvs = np.stack([uvs[corner_rows, 0], 1.0 - uvs[corner_rows, 1]], axis=1)
        resolved = material or Material("displayColor", (1.0, 1.0, 1.0, 1.0)) if tints is not None or material else Material()
        source = f"{self._path}: {prim.GetPath()}"
        return build_part(source, points[corners[corner_rows]], inverse.reshape(-1, 3), None, uvs, resolved, matrix, tints)

    def _primvar(self, prim: Any, names: tuple[str, ...], corners: I64, sizes: I64, width: int) -> F64 | None:
        """Returns the values of the first existing primvar at each corner, (C, width), or None."""
        from pxr import UsdGeom

        api = UsdGeom.PrimvarsAPI(prim)
        primvar = next((p for p in (api.FindPrimvarWithInheritance(name) for name in names) if p and p.HasValue()), None)
        if primvar is None:
            return None
        values = _array(primvar.ComputeFlattened(), width)
        value_index = {"constant": np.zeros(len(corners), dtype=np.int64), "uniform": np.repeat(np.arange(len(sizes)), sizes), "vertex": corners,
              "varying": corners, "faceVarying": np.arange(len(corners))}[str(primvar.GetInterpolation())]  # fmt: skip
        if not len(values) or value_index.max() >= len(values):
            self.warnings.append(f"{prim.GetPath()}: {primvar.GetPrimvarName()} has {len(values)} values, too few; ignored")
            return None
        corner_values: F64 = values[value_index]
        return corner_values

    def _material(self, material: Any) -> Material | None:
        if not material:
            return None
        key = str(material.GetPath())
        if key not in self._materials:
            self._materials[key] = self._surface(material, key)
        return self._materials[key]

    def _surface(self, material: Any, key: str) -> Material:
        shader = material.ComputeSurfaceSource()[0] or material.ComputeSurfaceSource("mdl")[0]
        if not shader or str(shader.GetIdAttr().Get()) != "UsdPreviewSurface":
            self.warnings.append(f"material {key} is not a UsdPreviewSurface; the surface is light grey")
            return Material(key)
        texture, color = self._input(shader, "diffuseColor")
        values = {name: self._input(shader, name)[1] for name in ("metallic", "roughness", "opacity")}
        rgb = (1.0, 1.0, 1.0) if texture else _srgb(color if color is not None else (0.18, 0.18, 0.18))
        alpha = _number(values["opacity"], 1.0)
        return Material(
            key, (*rgb, alpha), texture, metallic=_number(values["metallic"], 0.0), roughness=_number(values["roughness"], 0.5),
            alpha_mode="opaque" if alpha >= 0.999 else "blend",
        )  # fmt: skip

    def _input(self, shader: Any, name: str) -> tuple[Any, Any]:
        """Returns the texture and the value of a shader input; each may be None."""
        source = shader.GetInput(name)
        if not source:
            return None, None
        if not source.HasConnectedSource():
            return None, source.Get()
        from pxr import UsdShade

        reader = UsdShade.Shader(source.GetConnectedSources()[0][0].source.GetPrim())
        file = reader.GetInput("file") if reader else None
        asset = file.Get() if file else None
        if not asset or name != "diffuseColor":
            return None, None
        return self._texture(str(asset.path)), None

    def _texture(self, uri: str) -> Any:
        if self._path.suffix.lower() == ".usdz":
            from pxr import Ar

            resolver = Ar.GetResolver()
            asset = resolver.OpenAsset(resolver.Resolve(f"{self._path}[{uri.removeprefix('./')}]"))
            return (
                self._textures.from_bytes(f"{self._path}: {uri}", bytes(asset.GetBuffer()), self.warnings.append)
                if asset
                else None
            )
        return self._textures.from_uri(
            os.path.relpath(uri, self._path.parent) if os.path.isabs(uri) else uri, self._path, self._files, self.warnings.append
        )


def _semantic_class(prim: Any) -> str:
    """Returns the semantic class of a prim or of its nearest labelled ancestor; empty without a label."""
    while prim and str(prim.GetPath()) != "/":
        for attribute in prim.GetAttributes():
            if attribute.GetName().startswith("semantic:") and attribute.GetName().endswith(":params:semanticData"):
                return class_name(str(attribute.Get()))
        prim = prim.GetParent()
    return ""


def _array(values: Any, width: int) -> F64:
    return np.asarray(values if values is not None else [], dtype=np.float64).reshape(-1, width)


def _number(value: Any, default: float) -> float:
    return default if value is None else min(max(float(value), 0.0), 1.0)


def _srgb(color: Any) -> tuple[float, float, float]:
    red, green, blue = srgb_from_linear([float(c) for c in color]).tolist()
    return red, green, blue
