"""Fuses posed RGB-D into a mesh and measures distances to meshes, with Open3D. No other file imports it."""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.geometry.transforms import Mat4, invert
from gibson_sim_tools.scanning.coloured_mesh import ColouredMesh, level_transform, moved, thinned, welded, without_small_parts
from gibson_sim_tools.scanning.planes import SnapReport, snapped
from gibson_sim_tools.scanning.posed_rgbd import PosedRgbd, ScanError, depth_units
from gibson_sim_tools.scanning.settings import FuseSettings
from gibson_sim_tools.scanning.voxel_size import BLOCK_VOXELS, VoxelSize, select_voxel_size

F64 = NDArray[np.float64]
F32 = NDArray[np.float32]
Progress = Callable[[float], None]

_FIRST_BLOCKS = 20_000
"""Initial capacity of the voxel grid without an estimate, blocks; it grows, and holds both the old and the new grid meanwhile."""
_SPARE = 1.2
"""Initial capacity relative to the estimate."""
_SAMPLED = 4
"""Distance of the pixels at which Open3D looks for voxels."""
_WELD = 0.1
"""Merging distance of vertices, voxels."""
_ROUGHLY = 2
"""The fast simplification leaves this many times the requested triangles to the slow, accurate one."""
_MOST_VERTICES = 60_000_000


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


def chosen_frames(rgbd: PosedRgbd, settings: FuseSettings) -> range:
    """Returns the numbers of the frames to fuse."""
    return range(0, len(rgbd), settings.stride)


@dataclass(frozen=True, slots=True, eq=False)
class Fusion:
    """A fused mesh, and how it came about."""

    mesh: ColouredMesh
    """In the frame of the scan, or level."""
    voxel: float
    """Edge of the voxels, metres."""
    selected: VoxelSize | None
    """Why the voxels have that size; None = it was given."""
    snap: SnapReport | None
    """What was made plane; None = nothing was to be."""
    T_level_scan: Mat4 | None
    """Takes the frame of the scan to the level one, (4, 4); None = there is no level surface."""


def fuse(rgbd: PosedRgbd, settings: FuseSettings, progress: Progress = lambda _: None) -> ColouredMesh:
    """Returns the mesh of ``fuse_scan``."""
    return fuse_scan(rgbd, settings, progress).mesh


def fuse_scan(
    rgbd: PosedRgbd, settings: FuseSettings, progress: Progress = lambda _: None, *, depth_only: Collection[int] = ()
) -> Fusion:
    """Returns the surface in posed RGB-D, in its world frame (or levelled): the triangles of a truncated signed distance field.

    Args:
        rgbd: the frames.
        settings: settings of the fusion.
        progress: called with the fraction that is done, 0 to 1.
        depth_only: numbers of frames whose colours are not used. Vertices that they alone show have the colour of the nearest other ones.

    Raises:
        EnvironmentProblemError: Open3D is not installed.
        ScanError: an image is broken, or nothing is in range.
    """
    open3d()
    selected = None if settings.voxel else select_voxel_size(rgbd, settings, chosen_frames(rgbd, settings))
    settings = settings if selected is None else replace(settings, voxel=selected.voxel)
    blocks = _FIRST_BLOCKS if selected is None else round(_SPARE * selected.blocks)
    mesh = _surface(rgbd, settings, blocks, frozenset(depth_only), progress)
    mesh, snap = snapped(mesh, settings.voxel, settings.snap) if settings.snap else (mesh, None)
    progress(0.98)
    if settings.triangles and len(mesh.triangles) > settings.triangles:
        mesh = simplified(mesh, settings.triangles)
    T = _level(mesh, rgbd, settings.level)
    progress(1.0)
    return Fusion(moved(mesh, T) if settings.level and T is not None else mesh, settings.voxel, selected, snap, T)


def _level(mesh: ColouredMesh, rgbd: PosedRgbd, needed: bool) -> Mat4 | None:
    """Returns T_level_scan; None if there is no level surface and none is needed."""
    try:
        return level_transform(mesh, rgbd.poses)
    except ScanError:
        if needed:
            raise
        return None


def _surface(
    rgbd: PosedRgbd, settings: FuseSettings, blocks: int, depth_only: Collection[int], progress: Progress
) -> ColouredMesh:
    """Returns the triangles of the distance field of all frames, without small parts; ``blocks`` are allocated at first."""
    o3d = open3d()
    core = o3d.core
    grid = o3d.t.geometry.VoxelBlockGrid(
        ("tsdf", "weight", "color"), (core.float32, core.uint16, core.uint16), ((1), (1), (3)),
        settings.voxel, BLOCK_VOXELS, blocks,
    )  # fmt: skip
    # Open3D truncates projected points to pixels, so its pixel centres are at halves; ours are at whole numbers.
    K = core.Tensor(rgbd.intrinsics.matrix + np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.5], [0.0, 0.0, 0.0]]))
    reach = (rgbd.depth_scale, settings.depth_max, settings.truncation)
    # Those without colours come last: what is there before them has the colours of the others alone.
    chosen = sorted(chosen_frames(rgbd, settings), key=lambda number: number in depth_only)
    with_colors = sum(number not in depth_only for number in chosen)
    coloured: ColouredMesh | None = None
    for done, number in enumerate(chosen):
        if done == with_colors:
            coloured = _extracted(grid, settings)
        frame = rgbd[number]
        units = depth_units(frame.depth, rgbd.depth_scale)
        if _is_seen(frame.depth, settings.depth_max):
            depth, color = (o3d.t.geometry.Image(core.Tensor(a)) for a in (units, frame.rgb))
            T_camera_world = core.Tensor(invert(frame.T_world_camera))
            blocks = grid.compute_unique_block_coordinates(depth, K, T_camera_world, *reach)
            grid.integrate(blocks, depth, color, K, K, T_camera_world, *reach)
        progress(0.9 * (done + 1) / len(chosen))
    mesh = _extracted(grid, settings)
    if coloured is not None:
        mesh = replace(mesh, colors=coloured.colors[cKDTree(coloured.vertices).query(mesh.vertices)[1]])
    mesh = welded(mesh, _WELD * settings.voxel)
    if settings.min_part:
        mesh = without_small_parts(mesh, settings.min_part)
    if not len(mesh.triangles):
        raise ScanError(f"{rgbd.folder}: nothing is left of the mesh; give a smaller --min-weight or --min-part")
    return mesh


def _is_seen(depth: F32, depth_max: float) -> bool:
    """Returns whether Open3D finds voxels in a depth image (H, W), metres: it samples every fourth row and column, and fails if it finds none."""
    height, width = (size // _SAMPLED * _SAMPLED for size in depth.shape)
    samples = depth[:height:_SAMPLED, :width:_SAMPLED]
    return bool(((samples > 0.0) & (samples < depth_max)).any())


def _extracted(grid: Any, settings: FuseSettings) -> ColouredMesh:
    """Returns the triangles of a distance field."""
    if not grid.hashmap().size():
        raise ScanError(_nothing(settings))
    found = grid.extract_triangle_mesh(settings.min_weight - 0.5)  # the threshold is exclusive
    if found.is_empty():
        raise ScanError(_nothing(settings))
    if len(found.vertex.positions) > _MOST_VERTICES:
        raise ScanError(f"the mesh has {len(found.vertex.positions)} vertices; give a larger --voxel than {settings.voxel:g} m")
    colors = np.clip(np.rint(found.vertex.colors.numpy() * 255.0), 0, 255).astype(np.uint8)
    return ColouredMesh(found.vertex.positions.numpy().copy(), found.triangle.indices.numpy().astype(np.int32), colors)


def _nothing(settings: FuseSettings) -> str:
    return (
        f"no surface was seen by {settings.min_weight:g} images or more within {settings.depth_max:g} m; "
        "give a smaller --min-weight or a larger --depth-max, and check the depth scale and the poses"
    )


def simplified(mesh: ColouredMesh, triangles: int) -> ColouredMesh:
    """Returns the mesh with about ``triangles`` triangles, simplified by quadric error.

    Open3D optimises vertex positions and takes many times as long as meshoptimizer, which keeps them and therefore goes first.

    Raises:
        EnvironmentProblemError: Open3D is not installed.
        MeshError: meshoptimizer is not installed.
    """
    o3d = open3d()
    if len(mesh.triangles) > _ROUGHLY * triangles:
        mesh = thinned(mesh, _ROUGHLY * triangles)
    full = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices.astype(np.float64)), o3d.utility.Vector3iVector(mesh.triangles)
    )
    full.vertex_colors = o3d.utility.Vector3dVector(mesh.colors.astype(np.float64) / 255.0)
    less = full.simplify_quadric_decimation(triangles)
    colors = np.clip(np.rint(np.asarray(less.vertex_colors) * 255.0), 0, 255).astype(np.uint8)
    return ColouredMesh(np.asarray(less.vertices, dtype=np.float32), np.asarray(less.triangles, dtype=np.int32), colors)


def distances(points: F64, vertices: NDArray[Any], triangles: NDArray[np.int32]) -> F32:
    """Returns the distances (N,), metres, from points (N, 3) to a mesh.

    Raises:
        EnvironmentProblemError: Open3D is not there.
    """
    o3d = open3d()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(
        o3d.core.Tensor(np.ascontiguousarray(vertices, dtype=np.float32)),
        o3d.core.Tensor(np.ascontiguousarray(triangles, dtype=np.uint32)),
    )
    return np.asarray(scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy(), dtype=np.float32)
