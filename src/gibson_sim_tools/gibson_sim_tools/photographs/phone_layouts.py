"""Finds posed photographs in the exports of scanning apps: Polycam's raw data, Record3D's frames.

Both hold ARKit's poses: the world is y up, the cameras look along -z with y up.
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
from gibson_sim_tools.photographs.photographs import Lens, Photograph, Photographs, posed
from gibson_sim_tools.scanning.layouts import read_json
from gibson_sim_tools.scanning.pose_conventions import OPTICAL_OPENGL
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics, ScanError

F64 = NDArray[np.float64]

_POLYCAM = (("corrected_cameras", "corrected_images"), ("cameras", "images"))
"""Folders of cameras and photographs in ``keyframes``: after Polycam's own correction, and before."""
_RECORD3D = ("rgb", "EXR_RGBD/rgb", "rgbd")
_IMAGES = (".jpg", ".jpeg", ".png")
_HALF = 0.5
"""Pixel centres of both are at halves, ours at whole numbers."""


def polycam_cameras(folder: Path) -> tuple[Path, Path] | None:
    """Returns the folders of cameras and photographs of an export of Polycam, or None."""
    for cameras, images in _POLYCAM:
        places = folder / "keyframes" / cameras, folder / "keyframes" / images
        if all(is_folder(place) for place in places) and any(p.suffix == ".json" for p in places[0].iterdir()):
            return places
    return None


def polycam(folder: Path, cameras: Path, images: Path, longest: int) -> Photographs:
    """Returns the photographs of an export of Polycam ("raw data").

    Raises:
        ScanError: a camera lacks a value.
    """
    items = []
    for path in sorted((p for p in cameras.iterdir() if p.suffix == ".json"), key=_number):
        values = read_json(path)
        T = np.eye(4)
        T[:3] = [[_value(str(path), values, f"t_{row}{column}") for column in range(4)] for row in range(3)]
        intrinsics = Intrinsics(
            int(_value(str(path), values, "width")), int(_value(str(path), values, "height")),
            _value(str(path), values, "fx"), _value(str(path), values, "fy"),
            _value(str(path), values, "cx") - _HALF, _value(str(path), values, "cy") - _HALF,
        )  # fmt: skip
        depth = folder / "keyframes" / "depth" / f"{path.stem}.png"
        image = next((p for s in _IMAGES if is_file(p := images / f"{path.stem}{s}")), images / f"{path.stem}.jpg")
        items.append(Photograph(image, Lens(intrinsics), T @ OPTICAL_OPENGL, depth if is_file(depth) else None))
    return posed(folder, "polycam", items, longest)


def record3d_images(folder: Path) -> Path | None:
    """Returns the folder of the photographs of an export of Record3D, or None."""
    if not is_file(folder / "metadata.json"):
        return None
    return next((folder / name for name in _RECORD3D if is_folder(folder / name)), None)


def record3d(folder: Path, images: Path, longest: int) -> Photographs:
    """Returns the photographs of an export of Record3D.

    Raises:
        ScanError: the metadata are not Record3D's, or there are more photographs than poses.
    """
    path = folder / "metadata.json"
    values = read_json(path)
    poses = np.array(_list(path, values, "poses", 7), dtype=np.float64).reshape(-1, 7)
    K = np.array(_list(path, values, "K", None), dtype=np.float64)
    if K.size != 9:
        raise ScanError(f"{path}: K has {K.size} numbers, must have 9; is it Record3D's?")
    # By columns.
    K = K.reshape(3, 3).T
    intrinsics = Intrinsics(
        int(_value(str(path), values, "w")), int(_value(str(path), values, "h")),
        float(K[0, 0]), float(K[1, 1]), float(K[0, 2]) - _HALF, float(K[1, 2]) - _HALF,
    )  # fmt: skip
    files = sorted((p for p in images.iterdir() if p.suffix.lower() in _IMAGES and p.stem.isdigit()), key=_number)
    if len(files) > len(poses):
        raise ScanError(f"{path}: has {len(poses)} poses for {len(files)} photographs in {images.name}/; export again")
    items = []
    for file, (*quat, x, y, z) in zip(files, poses.tolist(), strict=False):
        T = np.eye(4)
        T[:3, :3] = matrix_from_quat((quat[0], quat[1], quat[2], quat[3])) if np.isfinite(quat).all() else np.nan
        T[:3, 3] = x, y, z
        items.append(Photograph(file, Lens(intrinsics), T @ OPTICAL_OPENGL))
    return posed(folder, "record3d", items, longest)


def _number(path: Path) -> tuple[int, str]:
    return (int(path.stem), "") if path.stem.isdigit() else (0, path.stem)


def _value(what: str, values: Any, name: str) -> float:
    value = values.get(name) if isinstance(values, Mapping) else None
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        raise ScanError(f"{what}: {name} is {quoted(value)}, must be a number")
    return float(value) if math.isfinite(value) else math.nan


def _list(path: Path, values: Any, name: str, width: int | None) -> list[Any]:
    found = values.get(name) if isinstance(values, Mapping) else None
    good = isinstance(found, list) and all(
        (width is None and isinstance(row, (int, float))) or (isinstance(row, list) and len(row) == width) for row in found
    )
    if not good:
        raise ScanError(
            f"{path}: has no list {quoted(name)}{'' if width is None else f' of {width} numbers each'}; is it Record3D's?"
        )
    assert isinstance(found, list)
    return found
