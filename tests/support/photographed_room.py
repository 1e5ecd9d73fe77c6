"""A box room with painted walls, photographed with depth from known places: folders as scanners and apps export them."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import quat_from_matrix
from gibson_sim_tools.scanning.trajectories import write_trajectory_log
from gibson_sim_tools.scanning.triangle_mesh import TriangleMesh, transformed, write_ply
from support.scans import sheet

F64 = NDArray[np.float64]

SIZE = np.array([4.0, 3.0, 2.4])
"""Metres; a corner of the floor is the origin, z is up."""
WIDTH, HEIGHT, FOCAL = 64, 48, 40.0
"""Of the photographs, pixels."""
COUNT = 12
T_FIRST_WORLD = np.array([[1.0, 0, 0, -2], [0, 0, -1, 1.2], [0, 1, 0, -1.5], [0, 0, 0, 1]])
"""Takes the frame of the room to one as scanners have it: that of an upright camera in its middle, y down."""


def room_poses() -> F64:
    """Returns T_world_camera (COUNT, 4, 4), optical frames: all around, every other one towards the floor."""
    out = np.tile(np.eye(4), (COUNT, 1, 1))
    for k in range(COUNT):
        yaw, pitch = 2 * np.pi * k / COUNT, -0.6 if k % 2 else -0.1
        ahead = np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])
        right = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
        out[k, :3, :3] = np.stack([right, np.cross(ahead, right), ahead], axis=1)
        out[k, :3, 3] = (2.0 + 0.8 * np.cos(yaw + 2.6), 1.5 + 0.6 * np.sin(yaw + 2.6), 1.2)
    return out


def room_image(T_world_camera: F64, part: int = 1) -> tuple[NDArray[np.uint8], NDArray[np.uint16]]:
    """Returns the photograph (H, W, 3), BGR, and the depth (H, W), millimetres; ``part``: of their sides."""
    v, u = (np.mgrid[: HEIGHT // part, : WIDTH // part] + 0.5) * part - 0.5
    rays = (
        np.stack([(u - (WIDTH - 1) / 2) / FOCAL, (v - (HEIGHT - 1) / 2) / FOCAL, np.ones_like(u)], axis=-1)
        @ T_world_camera[:3, :3].T
    )
    eye = T_world_camera[:3, 3]
    with np.errstate(divide="ignore"):
        depth = (np.where(rays > 0.0, SIZE - eye, -eye) / rays).min(axis=-1)
    return _paint(eye + rays * depth[..., None]), np.rint(1000.0 * depth).astype(np.uint16)


def _paint(points: F64) -> NDArray[np.uint8]:
    waves = np.sin(3.0 * points + np.array([0.0, 1.0, 2.0])) * np.cos(2.0 * points[..., [1, 2, 0]])
    return np.rint(120.0 + 80.0 * waves).astype(np.uint8)


def room_mesh(edge: float = 0.2) -> TriangleMesh:
    """Returns the room as triangles that face inwards, without the floor at x < 0.6."""
    x, y, z = SIZE.tolist()
    return TriangleMesh(*_coloured([
        sheet((0.6, 0, 0), (x - 0.6, 0, 0), (0, y, 0), edge), sheet((0, 0, z), (0, y, 0), (x, 0, 0), edge),
        sheet((0, 0, 0), (0, y, 0), (0, 0, z), edge), sheet((x, 0, 0), (0, 0, z), (0, y, 0), edge),
        sheet((0, 0, 0), (0, 0, z), (x, 0, 0), edge), sheet((0, y, 0), (x, 0, 0), (0, 0, z), edge),
    ]))  # fmt: skip


def _coloured(sheets: list[tuple[F64, NDArray[np.int64]]]) -> tuple[F64, NDArray[np.int64], NDArray[np.uint8]]:
    first = np.cumsum([0, *(len(points) for points, _ in sheets)])
    vertices = np.concatenate([points for points, _ in sheets])
    triangles = np.concatenate([corners + k for (_, corners), k in zip(sheets, first, strict=False)])
    return vertices, triangles, np.ascontiguousarray(_paint(vertices)[:, ::-1])


def write_rgbd(folder: Path, T_frame_world: F64 = T_FIRST_WORLD) -> Path:
    """Writes the photographs with depth in Open3D's layout, in another frame than that of the room, and returns the folder."""
    for name in ("color", "depth"):
        (folder / name).mkdir(parents=True)
    for k, T in enumerate(room_poses()):
        color, depth = room_image(T)
        cv2.imwrite(str(folder / f"color/{k:06d}.png"), color)
        cv2.imwrite(str(folder / f"depth/{k:06d}.png"), depth)
    write_trajectory_log(folder / "trajectory.log", T_frame_world @ room_poses())
    matrix = [FOCAL, 0.0, 0.0, 0.0, FOCAL, 0.0, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, 1.0]
    (folder / "intrinsic.json").write_text(json.dumps({"width": WIDTH, "height": HEIGHT, "intrinsic_matrix": matrix}))
    return folder


def write_mesh(file: Path, T_frame_world: F64 = T_FIRST_WORLD) -> Path:
    """Writes the mesh of the room in a frame and returns the file."""
    write_ply(file, transformed(room_mesh(), T_frame_world))
    return file


def write_nerfstudio(folder: Path) -> Path:
    """Writes the photographs in nerfstudio's layout, in the frame of the room, and returns the folder."""
    (folder / "images").mkdir(parents=True)
    frames = []
    for k, T in enumerate(room_poses()):
        cv2.imwrite(str(folder / f"images/{k:04d}.png"), room_image(T)[0])
        frames.append({"file_path": f"images/{k:04d}.png", "transform_matrix": (T @ np.diag([1.0, -1.0, -1.0, 1.0])).tolist()})
    camera = {"w": WIDTH, "h": HEIGHT, "fl_x": FOCAL, "fl_y": FOCAL, "cx": WIDTH / 2, "cy": HEIGHT / 2, "camera_model": "OPENCV"}
    (folder / "transforms.json").write_text(json.dumps({**camera, "frames": frames}))
    return folder


def write_colmap(folder: Path) -> Path:
    """Writes the photographs in COLMAP's layout, in the frame of the room, and returns the folder."""
    (folder / "images").mkdir(parents=True)
    (folder / "sparse/0").mkdir(parents=True)
    lines = []
    for k, T in enumerate(room_poses()):
        cv2.imwrite(str(folder / f"images/{k:04d}.png"), room_image(T)[0])
        T_camera_world = np.linalg.inv(T)
        x, y, z, w = quat_from_matrix(T_camera_world[:3, :3])
        shift = " ".join(str(c) for c in T_camera_world[:3, 3])
        lines.append(f"{k + 1} {w} {x} {y} {z} {shift} 1 {k:04d}.png\n\n")
    (folder / "sparse/0/images.txt").write_text("".join(lines))
    (folder / "sparse/0/cameras.txt").write_text(f"1 PINHOLE {WIDTH} {HEIGHT} {FOCAL} {FOCAL} {WIDTH / 2} {HEIGHT / 2}\n")
    return folder


T_ARKIT_WORLD = np.array([[1.0, 0, 0, -2], [0, 0, 1, -1.2], [0, -1, 0, 1.5], [0, 0, 0, 1]])
"""Takes the frame of the room to one of a phone: y is up, the origin is its first place."""


def write_polycam(folder: Path) -> Path:
    """Writes raw data as Polycam exports them, photographed in portrait, with depth of half the size, and returns the folder."""
    for name in ("images", "cameras", "depth"):
        (folder / "keyframes" / name).mkdir(parents=True)
    upright = np.eye(4)
    upright[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    for k, T in enumerate(room_poses() @ upright):
        color, depth = room_image(T)[0], room_image(T, 2)[1]
        cv2.imwrite(str(folder / f"keyframes/images/{k}.png"), color)
        cv2.imwrite(str(folder / f"keyframes/depth/{k}.png"), depth)
        opengl = T_ARKIT_WORLD @ T @ np.diag([1.0, -1.0, -1.0, 1.0])
        pose = {f"t_{row}{column}": float(opengl[row, column]) for row in range(3) for column in range(4)}
        camera = {
            "width": WIDTH,
            "height": HEIGHT,
            "fx": FOCAL,
            "fy": FOCAL,
            "cx": WIDTH / 2,
            "cy": HEIGHT / 2,
            "blur_score": 9.0,
        }
        (folder / f"keyframes/cameras/{k}.json").write_text(json.dumps({**camera, **pose}))
    return folder
