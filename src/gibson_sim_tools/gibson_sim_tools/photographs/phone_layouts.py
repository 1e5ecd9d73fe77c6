"""Opens posed photographs in exports of scanning apps: Polycam's raw data, Record3D's frames.

Both hold ARKit's poses: T_world_camera in a world with y up, cameras in OpenGL's convention (looking along -z, y up).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import matrix_from_quat
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, is_folder
from gibson_sim_tools.scanning.layouts import read_json
from gibson_sim_tools.scanning.pose_conventions import OPTICAL_OPENGL
from gibson_sim_tools.scanning.posed_images import (
    CameraModel,
    Photograph,
    Photographs,
    ScanError,
    intrinsics_of,
    without_lost_poses,
)

F64 = NDArray[np.float64]

_POLYCAM_FOLDERS = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
"""Folders of cameras and photographs in ``keyframes``: after Polycam's optimisation, and before it."""
_RECORD3D_FOLDERS = ("rgb", "EXR_RGBD/rgb", "rgbd")
_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
_PIXEL_CENTRE = 0.5
"""Pixel centre of both apps, pixels; ours is at whole numbers."""


def find_polycam_folders(folder: Path) -> tuple[Path, Path] | None:
    """Returns the folders of cameras and photographs of a Polycam export; None = the folder is none."""
    for cameras, images in _POLYCAM_FOLDERS:
        folders = folder / "keyframes" / cameras, folder / "keyframes" / images
        if all(is_folder(place) for place in folders) and any(p.suffix == ".json" for p in folders[0].iterdir()):
            return folders
    return None


def read_polycam(folder: Path, cameras: Path, images: Path, longest_side: int) -> Photographs:
    """Returns the photographs of a Polycam export ("raw data").

    Raises:
        ScanError: a camera lacks a value.
    """
    items = []
    for path in sorted((p for p in cameras.iterdir() if p.suffix == ".json"), key=_frame_number):
        values = read_json(path)
        T = np.eye(4)
        T[:3] = [[_read_number(str(path), values, f"t_{row}{column}") for column in range(4)] for row in range(3)]
        intrinsics = intrinsics_of(
            str(path), int(_read_number(str(path), values, "width")), int(_read_number(str(path), values, "height")),
            _read_number(str(path), values, "fx"), _read_number(str(path), values, "fy"),
            _read_number(str(path), values, "cx") - _PIXEL_CENTRE, _read_number(str(path), values, "cy") - _PIXEL_CENTRE,
        )  # fmt: skip
        depth = folder / "keyframes" / "depth" / f"{path.stem}.png"
        image = next((p for s in _IMAGE_SUFFIXES if is_file(p := images / f"{path.stem}{s}")), images / f"{path.stem}.jpg")
        items.append(Photograph(image, CameraModel(intrinsics), T @ OPTICAL_OPENGL, depth if is_file(depth) else None))
    return without_lost_poses(folder, "polycam", items, longest_side)


def find_record3d_images(folder: Path) -> Path | None:
    """Returns the folder of photographs of a Record3D export; None = the folder is none."""
    if not is_file(folder / "metadata.json"):
        return None
    return next((folder / name for name in _RECORD3D_FOLDERS if is_folder(folder / name)), None)


def read_record3d(folder: Path, images: Path, longest_side: int) -> Photographs:
    """Returns the photographs of a Record3D export.

    Raises:
        ScanError: the metadata are not Record3D's, or there are more photographs than poses.
    """
    path = folder / "metadata.json"
    values = read_json(path)
    poses = np.array(_read_list(path, values, "poses", 7), dtype=np.float64).reshape(-1, 7)
    K = np.array(_read_list(path, values, "K", None), dtype=np.float64)
    if K.size != 9:
        raise ScanError(f"{path}: K has {K.size} numbers, must have 9; is it Record3D's?")
    # Record3D writes K column-major.
    K = K.reshape(3, 3).T
    intrinsics = intrinsics_of(
        str(path), int(_read_number(str(path), values, "w")), int(_read_number(str(path), values, "h")),
        float(K[0, 0]), float(K[1, 1]), float(K[0, 2]) - _PIXEL_CENTRE, float(K[1, 2]) - _PIXEL_CENTRE,
    )  # fmt: skip
    files = sorted((p for p in images.iterdir() if p.suffix.lower() in _IMAGE_SUFFIXES and p.stem.isdigit()), key=_frame_number)
    if len(files) > len(poses):
        raise ScanError(f"{path}: has {len(poses)} poses for {len(files)} photographs in {images.name}/; export again")
    items = []
    for file, (*quat, x, y, z) in zip(files, poses.tolist(), strict=False):
        T = np.eye(4)
        T[:3, :3] = matrix_from_quat((quat[0], quat[1], quat[2], quat[3])) if np.isfinite(quat).all() else np.nan
        T[:3, 3] = x, y, z
        items.append(Photograph(file, CameraModel(intrinsics), T @ OPTICAL_OPENGL))
    return without_lost_poses(folder, "record3d", items, longest_side)


def _frame_number(path: Path) -> tuple[int, str]:
    return (int(path.stem), "") if path.stem.isdigit() else (0, path.stem)


def _read_number(what: str, values: Any, name: str) -> float:
    value = values.get(name) if isinstance(values, Mapping) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ScanError(f"{what}: {name} is {quoted(value)}, must be a number")
    return float(value) if math.isfinite(value) else math.nan


def _read_list(path: Path, values: Any, name: str, width: int | None) -> list[Any]:
    value = values.get(name) if isinstance(values, Mapping) else None
    is_valid = isinstance(value, list) and all(
        (width is None and isinstance(row, (int, float))) or (isinstance(row, list) and len(row) == width) for row in value
    )
    if not is_valid:
        raise ScanError(
            f"{path}: has no list {quoted(name)}{'' if width is None else f' of {width} numbers each'}; is it Record3D's?"
        )
    assert isinstance(value, list)
    return value
