"""Scenes of the renderer benchmarks, camera paths through them, and their meshes in the formats of third-party renderers."""

from __future__ import annotations

import hashlib
import math
import shutil
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.errors import ConfigError, GibsonSimError, SceneError
from gibson_sim.formats.load_mesh import load_mesh
from gibson_sim.geometry.transforms import R_LINK_OPTICAL, Mat4
from gibson_sim.maps.floor_map import scene_floor_map
from gibson_sim.maps.tour import choose_start, plan_tour
from gibson_sim.picture_files import write_picture
from gibson_sim.resources import cache_folder, find_scene
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.spec import SceneSpec
from gibson_sim.writing import replacing, write_file
from gibson_sim_bench.scenes import scan_like_mesh
from gibson_sim_bench.scenes.scan_like_mesh import make_scan_like_mesh
from gibson_sim_tools import generator
from gibson_sim_tools.generator.rooms import make_rooms, rooms_camera_path

CAMERA_HEIGHT = 1.2
"""Height of the camera above the floor, metres."""
_RADIUS = 0.25
"""Radius of the robot that the path is planned for, metres."""
_TOUR_M = 25.0
"""Length of the path on a floor, metres."""
_LOOK_AHEAD_M = 0.5
"""Distance along the path to the point that the camera looks at, metres."""
_UNITS = {"k": 1_000, "m": 1_000_000}


@dataclass(frozen=True, slots=True)
class BenchScene:
    """A scene of the benchmarks."""

    name: str
    """Name in the report; for a path, its last component."""
    path: Path
    rooms: int = 0
    """Number of triangles of generated rooms; 0 = not generated."""
    plan: Path | None = None
    """Scene from whose floor maps the camera path is planned; None = the scene itself."""


def bench_scene(name: str) -> BenchScene:
    """Returns a scene by its name or path; two kinds are generated once and cached for the user.

    ``rooms:100k`` is a generated floor of rooms with that many triangles; ``scan:garden_house:500k`` is a shipped scene as a scan-like mesh.

    Raises:
        ConfigError: ``rooms:`` or ``scan:`` is not followed by a number of triangles.
        SceneNotFoundError: there is no such scene.
        SceneError: the scene cannot be converted to a scan-like mesh.
    """
    kind, _, what = name.partition(":")
    if kind == "rooms" and what:
        triangles = parse_count(what)
        return BenchScene(name, _cached_rooms(triangles), triangles)
    path = find_scene(what.rpartition(":")[0] if kind == "scan" else name)
    if kind == "scan":
        return BenchScene(name, _cached_scan(path, parse_count(what.rpartition(":")[2])), plan=path)
    return BenchScene(path.stem if path.is_file() else path.name, path)


def parse_count(text: str) -> int:
    """Returns 500000 for ``500k`` and 1000000 for ``1m``.

    Raises:
        ConfigError: it is not a number from 1k to 20m.
    """
    unit = _UNITS.get(text[-1:].lower(), 1)
    try:
        count = int(float(text[:-1] if unit > 1 else text) * unit)
    except ValueError:
        count = 0
    if not 1_000 <= count <= 20_000_000:
        raise ConfigError(f"rooms:{text}: must be a number of triangles from 1k to 20m, such as rooms:500k")
    return count


def _cached_rooms(triangles: int) -> Path:
    sources = sorted(Path(generator.__file__).parent.glob("*.py"))
    return _cached(f"rooms_{triangles}", sources, "", lambda draft: make_rooms(draft, 0, triangles))


def _cached_scan(path: Path, triangles: int) -> Path:
    scene = load_scene(path)
    name = f"scan_{scene.name}_{triangles}"
    return _cached(
        name,
        [Path(scan_like_mesh.__file__)],
        scene.content_hash,
        lambda draft: make_scan_like_mesh(scene, triangles, draft),
    )


def _cached(name: str, sources: list[Path], content: str, make: Callable[[Path], object]) -> Path:
    """Returns a cache folder that ``make`` fills once for each version of its source code and its input."""
    digest = hashlib.sha256(content.encode())
    for source in sources:
        digest.update(source.read_bytes())
    folder = cache_folder("bench") / f"{name}_{digest.hexdigest()[:12]}"
    if not folder.is_dir():
        folder.parent.mkdir(parents=True, exist_ok=True)
        draft = Path(tempfile.mkdtemp(dir=folder.parent))
        try:
            make(draft)
            draft.rename(folder)
        except OSError:
            if not folder.is_dir():  # otherwise another process was faster
                raise
        finally:
            shutil.rmtree(draft, ignore_errors=True)
    return folder


def camera_path(scene: BenchScene, frames: int) -> list[Mat4]:
    """Returns ``frames`` poses T_world_camera (optical frame) on a fixed path over all floors of a scene, 1.2 m above them.

    Raises:
        SceneError: there is no free floor.
    """
    if scene.rooms:
        return rooms_camera_path(frames)
    spec = load_scene(scene.plan or scene.path)
    shares = np.diff(np.linspace(0, frames, len(spec.floors) + 1).round().astype(int))
    return [pose for z, count in zip(spec.floors, shares, strict=True) for pose in _path_on_floor(spec, z, int(count))]


def _path_on_floor(spec: SceneSpec, floor_z: float, frames: int) -> list[Mat4]:
    """Returns ``frames`` poses on a path over one floor."""
    one_floor = replace(spec, floor_z=floor_z, other_floors=(), ground_z=floor_z if spec.ground_z is not None else None)
    floor = scene_floor_map(one_floor, robot_height=CAMERA_HEIGHT + 0.1)
    x, y, _ = choose_start(floor, _RADIUS)
    return path_along(plan_tour(floor, (x, y), _RADIUS, _TOUR_M), floor_z + CAMERA_HEIGHT, frames)


def path_along(points: NDArray[np.float64], z: float, frames: int) -> list[Mat4]:
    """Returns poses T_world_camera (optical frame) evenly spaced on a polyline (N, 2) at height z, looking along it."""
    arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    poses = []
    for at in np.linspace(0.0, float(arc[-1]) - _LOOK_AHEAD_M, frames):
        x, y = (float(np.interp(at, arc, points[:, k])) for k in range(2))
        dx, dy = (float(np.interp(at + _LOOK_AHEAD_M, arc, points[:, k])) - c for k, c in enumerate((x, y)))
        yaw = math.atan2(dy, dx)
        pose = np.eye(4)
        pose[:2, :2] = [[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]]
        pose[:3, :3] = pose[:3, :3] @ R_LINK_OPTICAL
        pose[:3, 3] = (x, y, z)
        poses.append(pose)
    return poses


def export_for_peers(scene: BenchScene) -> Path:
    """Returns a folder with ``mesh.npz``, ``mesh.obj``, ``mesh.mtl`` and ``atlas.png`` for third-party renderers.

    Raises:
        SceneError: the scene is not one mesh with one texture, which all renderers render alike.
    """
    if scene.rooms:
        file = scene.path / "rooms.glb"
        folder = scene.path / "peers"
    else:
        spec = load_scene(scene.path)
        if len(spec.visuals) != 1 or spec.visuals[0].shape.kind != "mesh" or np.any(spec.visuals[0].pose.position):
            raise SceneError(
                f"{scene.name}: has {len(spec.visuals)} shapes; the peers render scenes of one mesh with one texture"
            )
        file = Path(spec.visuals[0].shape.mesh)
        folder = cache_folder("bench") / f"peers_{spec.content_hash[:24]}"
    if not (folder / "mesh.npz").is_file():
        folder.mkdir(parents=True, exist_ok=True)
        _export(scene.name, file, folder)
    return folder


def _export(name: str, file: Path, folder: Path) -> None:
    mesh = load_mesh(file, [file.parent])
    part = mesh.parts[0]
    if len(mesh.parts) != 1 or part.uvs is None or part.material.texture is None:
        raise SceneError(f"{name}: has {len(mesh.parts)} materials; the peers render scenes of one mesh with one texture")
    write_picture(folder / "atlas.png", part.material.texture.pixels[:, :, 2::-1], (cv2.IMWRITE_PNG_COMPRESSION, 1))
    write_file(folder / "mesh.mtl", "newmtl atlas\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nmap_Kd atlas.png\n")
    with replacing(folder / "mesh.obj") as draft, draft.open("w", encoding="utf-8") as obj:
        obj.write("mtllib mesh.mtl\nusemtl atlas\n")
        uvs = np.stack([part.uvs[:, 0], 1.0 - part.uvs[:, 1]], axis=1)
        for word, rows in (("v", part.vertices), ("vt", uvs), ("vn", part.normals)):
            obj.writelines(f"{word} " + " ".join(f"{c:.6g}" for c in row) + "\n" for row in rows.tolist())
        obj.writelines("f " + " ".join(f"{i}/{i}/{i}" for i in row) + "\n" for row in (part.triangles + 1).tolist())
    # Last, and atomically: if this file exists, all of them are complete.
    with replacing(folder / "mesh.npz") as draft:
        np.savez(draft, vertices=part.vertices, normals=part.normals, uvs=part.uvs, triangles=part.triangles)


def one_line(error: GibsonSimError | Exception) -> str:
    """Returns the message of an error in one line."""
    return " ".join(str(error).split())
