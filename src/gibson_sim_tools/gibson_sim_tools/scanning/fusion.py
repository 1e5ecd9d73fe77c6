"""TSDF fusion of posed RGB-D (volumetric integration, Curless and Levoy, SIGGRAPH 1996) and distances to meshes, with Open3D.

No other file imports Open3D.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.geometry.transforms import Mat4, invert
from gibson_sim_tools.scanning.planes import SnapReport, snap_to_planes
from gibson_sim_tools.scanning.posed_images import PosedRgbd, ScanError, depth_units
from gibson_sim_tools.scanning.settings import FuseSettings
from gibson_sim_tools.scanning.triangle_mesh import (
    TriangleMesh,
    decimated,
    level_transform,
    transformed,
    weld_vertices,
    without_small_components,
)
from gibson_sim_tools.scanning.voxel_size import BLOCK_VOXELS, VoxelSize, select_voxel_size

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
Progress = Callable[[float], None]

_DEFAULT_BLOCKS = 20_000
"""Initial capacity of the voxel block grid without an estimate, blocks. Growth needs memory for the old and the new grid."""
_CAPACITY_FACTOR = 1.2
"""Initial capacity per estimated number of blocks."""
_OPEN3D_PIXEL_STRIDE = 4
"""Stride of the pixels at which Open3D allocates voxel blocks, pixels."""
_WELD_VOXELS = 0.1
"""Cell size of vertex welding, voxels."""
_PRESIMPLIFIED_FACTOR = 2
"""Triangles after the fast decimation per requested triangle; the accurate simplification removes the rest."""
_MAX_VERTICES = 60_000_000
"""Largest number of vertices of a mesh."""


def open3d() -> Any:
    """Returns the module ``open3d``.

    Raises:
        EnvironmentProblemError: it is not installed or cannot be loaded.
    """
    try:
        import open3d as package
    except ImportError as error:
        raise EnvironmentProblemError(
            f"Open3D cannot be loaded ({error}); install it with: pip install 'gibson_sim_tools[scanning]' (on Debian and Ubuntu also: "
            "apt install libusb-1.0-0 libgomp1)"
        ) from error
    return package


def selected_frames(rgbd: PosedRgbd, settings: FuseSettings) -> range:
    """Returns the numbers of the frames to fuse."""
    return range(0, len(rgbd), settings.stride)


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """Result of a fusion."""

    mesh: TriangleMesh
    """In the frame of the scan, or levelled."""
    voxel: float
    """Edge of the voxels, metres."""
    selected: VoxelSize | None
    """The automatic selection of the voxel size; None = the size was given."""
    snap: SnapReport | None
    """Report of plane snapping; None = it is disabled."""
    T_level_scan: Mat4 | None
    """(4, 4), takes the frame of the scan to the level frame; None = there is no level surface."""


def fuse(rgbd: PosedRgbd, settings: FuseSettings, progress: Progress = lambda _: None) -> TriangleMesh:
    """Returns the mesh of ``fuse_scan``."""
    return fuse_scan(rgbd, settings, progress).mesh


def fuse_scan(
    rgbd: PosedRgbd, settings: FuseSettings, progress: Progress = lambda _: None, *, depth_only: Collection[int] = ()
) -> Fusion:
    """Returns the mesh of posed RGB-D, in its world frame (or levelled), extracted from a truncated signed distance field (TSDF).

    Args:
        rgbd: the frames.
        settings: settings of the fusion.
        progress: called with the fraction that is done, 0 to 1.
        depth_only: numbers of frames of which only the depth is used. Vertices without other frames get the colour of the nearest coloured one.

    Raises:
        EnvironmentProblemError: Open3D is not installed.
        ScanError: an image is broken, or nothing is in range.
    """
    open3d()
    selected = None if settings.voxel else select_voxel_size(rgbd, settings, selected_frames(rgbd, settings))
    settings = settings if selected is None else replace(settings, voxel=selected.voxel)
    blocks = _DEFAULT_BLOCKS if selected is None else round(_CAPACITY_FACTOR * selected.blocks)
    mesh = _integrate(rgbd, settings, blocks, frozenset(depth_only), progress)
    mesh, snap = snap_to_planes(mesh, settings.voxel, settings.snap) if settings.snap else (mesh, None)
    progress(0.98)
    if settings.triangles and len(mesh.triangles) > settings.triangles:
        mesh = simplify_quadric(mesh, settings.triangles)
    T = _level_transform(mesh, rgbd, settings.level)
    progress(1.0)
    return Fusion(transformed(mesh, T) if settings.level and T is not None else mesh, settings.voxel, selected, snap, T)


def _level_transform(mesh: TriangleMesh, rgbd: PosedRgbd, needed: bool) -> Mat4 | None:
    """Returns T_level_scan; None = there is no level surface, and none is needed."""
    try:
        return level_transform(mesh, rgbd.poses)
    except ScanError:
        if needed:
            raise
        return None


def _integrate(
    rgbd: PosedRgbd, settings: FuseSettings, blocks: int, depth_only: Collection[int], progress: Progress
) -> TriangleMesh:
    """Integrates all frames into a TSDF with an initial capacity of ``blocks`` and returns its mesh without small components."""
    o3d = open3d()
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (core.float32, core.uint16, core.uint16), ((1), (1), (3)),
        settings.voxel, BLOCK_VOXELS, blocks,
    )  # fmt: skip
    # Open3D truncates projected points to pixels, so its pixel centres are at halves; ours are at whole numbers.
    K = core.Tensor(rgbd.intrinsics.matrix + np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]))
    integration_limits = (rgbd.depth_scale, settings.depth_max, settings.truncation)
    # Frames of depth alone come last: the mesh extracted before them has the colours of the other frames only.
    numbers = sorted(selected_frames(rgbd, settings), key=lambda number: number in depth_only)
    color_count = sum(number not in depth_only for number in numbers)
    coloured: TriangleMesh | None = None
    for done, number in enumerate(numbers):
        if done == color_count:
            coloured = _extract_mesh(grid, settings)
        frame = rgbd[number]
        units = depth_units(frame.depth, rgbd.depth_scale)
        if _has_voxels(frame.depth, settings.depth_max):
            depth, color = (o3d.t.geometry.Image(core.Tensor(a)) for a in (units, frame.rgb))
            T_camera_world = core.Tensor(invert(frame.T_world_camera))
            blocks = grid.compute_unique_block_coordinates(depth, K, T_camera_world, *integration_limits)
            grid.integrate(blocks, depth, color, K, K, T_camera_world, *integration_limits)
        progress(0.9 * (done + 1) / len(numbers))
    mesh = _extract_mesh(grid, settings)
    if coloured is not None:
        assert coloured.colors is not None
        mesh = replace(mesh, colors=coloured.colors[cKDTree(coloured.vertices).query(mesh.vertices)[1]])
    mesh = weld_vertices(mesh, _WELD_VOXELS * settings.voxel)
    if settings.min_part:
        mesh = without_small_components(mesh, settings.min_part)
    if not len(mesh.triangles):
        raise ScanError(f"{rgbd.folder}: nothing is left of the mesh; give `scene fuse` a smaller --min-weight or --min-part")
    return mesh


def _has_voxels(depth: F32, depth_max: float) -> bool:
    """Returns whether Open3D can allocate blocks for a depth image (H, W), metres: it fails if no sampled pixel is in range."""
    height, width = (size // _OPEN3D_PIXEL_STRIDE * _OPEN3D_PIXEL_STRIDE for size in depth.shape)
    samples = depth[:height:_OPEN3D_PIXEL_STRIDE, :width:_OPEN3D_PIXEL_STRIDE]
    return bool(((samples > 0.0) & (samples < depth_max)).any())


def _extract_mesh(grid: Any, settings: FuseSettings) -> TriangleMesh:
    """Returns the mesh of a TSDF.

    Raises:
        ScanError: it is empty, or has too many vertices.
    """
    if not grid.hashmap().size():
        raise ScanError(_empty_mesh_message(settings))
    extracted = grid.extract_triangle_mesh(settings.min_weight - 0.5)  # the threshold is exclusive
    if extracted.is_empty():
        raise ScanError(_empty_mesh_message(settings))
    if len(extracted.vertex.positions) > _MAX_VERTICES:
        raise ScanError(
            f"the mesh has {len(extracted.vertex.positions)} vertices; give a larger --voxel than {settings.voxel:g} m"
        )
    colors = np.clip(np.rint(extracted.vertex.colors.numpy() * 255.0), 0, 255).astype(np.uint8)
    positions, indices = extracted.vertex.positions.numpy(), extracted.triangle.indices.numpy()
    return TriangleMesh(positions.astype(np.float64), indices.astype(np.int64), colors)


def _empty_mesh_message(settings: FuseSettings) -> str:
    return (
        f"no surface was seen by {settings.min_weight:g} images or more within {settings.depth_max:g} m; "
        "give a larger --depth-max, or `scene fuse` a smaller --min-weight, and check the depth scale and the poses"
    )


def simplify_quadric(mesh: TriangleMesh, triangles: int) -> TriangleMesh:
    """Returns the mesh simplified to about ``triangles`` triangles by quadric error metrics (Garland and Heckbert, SIGGRAPH 1997).

    Open3D optimises vertex positions and takes many times as long as meshoptimizer, which therefore decimates the mesh first.

    Raises:
        EnvironmentProblemError: Open3D is not installed.
        MeshError: meshoptimizer is not installed.
    """
    o3d = open3d()
    if len(mesh.triangles) > _PRESIMPLIFIED_FACTOR * triangles:
        mesh = decimated(mesh, _PRESIMPLIFIED_FACTOR * triangles)
    o3d_mesh = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices), o3d.utility.Vector3iVector(mesh.triangles.astype(np.int32))
    )
    assert mesh.colors is not None
    o3d_mesh.vertex_colors = o3d.utility.Vector3dVector(mesh.colors.astype(np.float64) / 255.0)
    simplify_quadric = o3d_mesh.simplify_quadric_decimation(triangles)
    colors = np.clip(np.rint(np.asarray(simplify_quadric.vertex_colors) * 255.0), 0, 255).astype(np.uint8)
    vertices, faces = np.asarray(simplify_quadric.vertices), np.asarray(simplify_quadric.triangles, dtype=np.int64)
    return TriangleMesh(vertices, faces, colors).single()


def distances_to_mesh(points: F64, vertices: NDArray[Any], triangles: NDArray[np.integer]) -> F32:
    """Returns the distances (N,), metres, from points (N, 3) to a mesh.

    Raises:
        EnvironmentProblemError: Open3D is not installed.
    """
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return np.asarray(scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy(), dtype=np.float32)
