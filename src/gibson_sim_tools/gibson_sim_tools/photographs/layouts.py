"""Opens posed photographs in folders of known layouts: posed RGB-D (ours, Open3D, 7-Scenes, TUM), COLMAP models, nerfstudio's
transforms.json, Polycam's raw data, Record3D.
"""

from __future__ import annotations

import math
import shlex
import struct
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import invert, matrix_from_quat
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, is_folder, read_file
from gibson_sim_tools.photographs.phone_layouts import find_polycam_folders, find_record3d_images, read_polycam, read_record3d
from gibson_sim_tools.scanning.layouts import LAYOUTS, open_posed_rgbd, read_json
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

TRANSFORMS = "transforms.json"
_COLMAP_FOLDERS = ("", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse")
_IMAGE_FOLDERS = ("images", "", "dense/images")
_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
_MIN_UNPOSED = 5
"""Least number of JPEG files beside a mesh without textures that are taken for photographs."""
POSE_PROGRAMS = (
    "COLMAP finds them (colmap automatic_reconstructor), or nerfstudio (ns-process-data), or export them from a scanning app with its poses "
    "(Polycam: raw data; Record3D)"
)
"""Programs that make poses, as text for messages."""
_MAX_BYTES = 2 * 2**30
"""Largest size of a file of a model, bytes; images.bin holds all feature points."""
_PIXEL_CENTRE = 0.5
"""Pixel centre of COLMAP and nerfstudio, pixels; ours is at whole numbers."""
_BAG_FILE = "metadata.yaml"
"""File that marks a folder of rosbag2."""
_CAMERA_MODELS = {
    "SIMPLE_PINHOLE": (0, 3), "PINHOLE": (1, 4), "SIMPLE_RADIAL": (2, 4), "RADIAL": (3, 5), "OPENCV": (4, 8),
    "OPENCV_FISHEYE": (5, 8), "FULL_OPENCV": (6, 12),
}  # fmt: skip
"""COLMAP's camera models: name -> (id in binary files, number of parameters)."""


def open_photographs(
    folder: Path, longest_side: int = 0, *, focal: tuple[float, float, float, float] | None = None, depth_scale: float | None = None
) -> Photographs:  # fmt: skip
    """Returns the posed photographs in a folder.

    Args:
        folder: folder of any known layout.
        longest_side: longest side to which images are scaled down, pixels; 0 = full size.
        focal: fx, fy, cx, cy in pixels; replaces the value of a folder of posed RGB-D.
        depth_scale: units of the depth images per metre; replaces the value of the folder.

    Raises:
        ScanError: the folder does not exist, has no known layout, or is incomplete; the message says what is missing.
    """
    if not folder.is_dir():
        raise ScanError(f"{folder}: is not a folder; give the one that contains the photographs and their poses")
    photographs = _open_with_cameras(folder, longest_side)
    if photographs is not None:
        if focal is not None:
            raise ScanError(
                f"{folder}: its layout ({photographs.layout}) holds the intrinsics of each photograph; leave out --intrinsics"
            )
        if depth_scale is None:
            return photographs
        return replace(photographs, items=tuple(replace(item, depth_scale=depth_scale) for item in photographs.items))
    if any(layout.recognises(folder) for layout in LAYOUTS):
        rgbd = open_posed_rgbd(folder, focal=focal, depth_scale=depth_scale)
        return replace(rgbd.photographs, longest_side=longest_side)
    check_no_bag(folder)
    if count_images(folder):
        raise ScanError(f"{folder}: has photographs but no poses; {POSE_PROGRAMS}")
    known = "; ".join(f"{layout.name}: {layout.files}" for layout in LAYOUTS)
    raise ScanError(
        f"{folder}: unknown layout of posed photographs; known: nerfstudio: {TRANSFORMS}; "
        f"colmap: cameras and images, .txt or .bin, also in sparse/0, and images/; polycam: keyframes/; record3d: metadata.json and rgb/; {known}"
    )


def check_no_bag(folder: Path) -> None:
    """Raises ScanError, which names the command that exports photographs, if a folder is a bag."""
    if is_file(folder / _BAG_FILE):
        raise ScanError(
            f"{folder}: is a bag; make photographs with poses of it first: gibson-sim export {shlex.quote(str(folder))} DIR --to nerfstudio"
        )


def unposed_text(folder: Path) -> str:
    """Returns what photographs without poses in a folder need, as text; empty if it holds fewer than ``_MIN_UNPOSED`` JPEG files."""
    count = sum(p.suffix.lower() in (".jpg", ".jpeg") for p in _files_beside(folder)) if is_folder(folder) else 0
    return f"{count} photographs in {folder} have no poses and are not used; {POSE_PROGRAMS}" if count >= _MIN_UNPOSED else ""


def _files_beside(folder: Path) -> Iterator[Path]:
    """Yields the files in a folder and its folder ``images``."""
    for place in (folder, folder / "images"):
        if is_folder(place):
            yield from place.iterdir()


def count_images(folder: Path) -> int:
    """Returns the number of photographs, with or without poses, in a folder and its folder ``images``."""
    return sum(p.suffix.lower() in _IMAGE_SUFFIXES for p in _files_beside(folder))


def _open_with_cameras(folder: Path, longest_side: int) -> Photographs | None:
    """Returns the photographs in a folder whose layout holds camera models; None = it has another layout."""
    if is_file(folder / TRANSFORMS):
        return _read_nerfstudio(folder, longest_side)
    keyframes = find_polycam_folders(folder)
    if keyframes is not None:
        return read_polycam(folder, *keyframes, longest_side)
    images = find_record3d_images(folder)
    if images is not None:
        return read_record3d(folder, images, longest_side)
    model_folder = next((folder / name for name in _COLMAP_FOLDERS if _model_suffix(folder / name)), None)
    return None if model_folder is None else _read_colmap(folder, model_folder, longest_side)


def _read_nerfstudio(folder: Path, longest_side: int) -> Photographs:
    path = folder / TRANSFORMS
    values = read_json(path)
    frames = values.get("frames") if isinstance(values, dict) else None
    if not isinstance(frames, list):
        raise ScanError(f"{path}: has no list 'frames'; is it nerfstudio's?")
    cameras: dict[tuple[Any, ...], CameraModel] = {}
    items = []
    applied_transform = (
        None
        if values.get("applied_transform") is None
        else _read_matrix(f"{path}: applied_transform", values["applied_transform"])
    )
    depth_scale = 1.0 / _read_number(str(path), values, "depth_unit_scale_factor", 0.001)
    for number, frame in enumerate(frames):
        what = f"{path}: frame {number}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise ScanError(f"{what}: has no 'file_path'")
        matrix = _read_matrix(what, frame.get("transform_matrix"))
        camera = _read_nerfstudio_camera(what, {**values, **frame})
        depth_file = frame.get("depth_file_path")
        depth_file = _resolve_inside(what, folder, depth_file) if isinstance(depth_file, str) else None
        camera = cameras.setdefault((camera.intrinsics, camera.distortion, camera.fisheye), camera)
        items.append(
            Photograph(
                _resolve_inside(what, folder, frame["file_path"]), camera, matrix @ OPTICAL_OPENGL, depth_file, depth_scale
            )
        )
    return without_lost_poses(folder, "nerfstudio", items, longest_side, applied_transform=applied_transform)


def _read_number(what: str, values: Mapping[str, Any], name: str, default: float | None = None) -> float:
    value = values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ScanError(f"{what}: {name} is {quoted(value)}, must be a number")
    return float(value)


def _read_matrix(what: str, value: object) -> F64:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise ScanError(f"{what}: the matrix is {quoted(value)}, must be 4x4 numbers by rows")
    return np.vstack([matrix[:3], [0.0, 0.0, 0.0, 1.0]])


def _read_nerfstudio_camera(what: str, values: Mapping[str, Any]) -> CameraModel:
    def number(name: str, default: float | None = None) -> float:
        return _read_number(what, values, name, default)

    width, height = number("w"), number("h")
    focal = (
        0.5 * width / math.tan(number("camera_angle_x") / 2.0) if "camera_angle_x" in values and "fl_x" not in values else None
    )
    fx = number("fl_x", focal)
    intrinsics = intrinsics_of(
        what,
        int(width),
        int(height),
        fx,
        number("fl_y", fx),
        number("cx", width / 2.0) - _PIXEL_CENTRE,
        number("cy", height / 2.0) - _PIXEL_CENTRE,
    )
    model = values.get("camera_model", "OPENCV")
    if model == "OPENCV_FISHEYE":
        return CameraModel(intrinsics, tuple(number(k, 0.0) for k in ("k1", "k2", "k3", "k4")), fisheye=True)
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        raise ScanError(f"{what}: camera_model {quoted(model)} is unknown; known: OPENCV, OPENCV_FISHEYE, PINHOLE")
    return CameraModel(intrinsics, tuple(number(k, 0.0) for k in ("k1", "k2", "p1", "p2", "k3")))


def _resolve_inside(what: str, folder: Path, name: str) -> Path:
    """Returns the path of a file inside the folder; the suffix .png may be omitted in the name.

    Raises:
        ScanError: the path leads out of the folder.
    """
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise ScanError(f"{what}: {quoted(name)} lies outside the folder; files must be named relative to it")
    return next((p for p in (path, path.with_name(path.name + ".png")) if is_file(p)), path)


def _model_suffix(model: Path) -> str:
    """Returns the suffix of COLMAP's model files in a folder, .bin or .txt; empty = there is no model."""
    return next((s for s in (".bin", ".txt") if all(is_file(model / f"{name}{s}") for name in ("cameras", "images"))), "")


def _read_colmap(folder: Path, model: Path, longest_side: int) -> Photographs:
    suffix = _model_suffix(model)
    cameras_file, images_file = model / f"cameras{suffix}", model / f"images{suffix}"
    camera_models: dict[int, CameraModel] = {}
    try:
        for key, kind, width, height, values in (
            _read_cameras_bin(cameras_file) if suffix == ".bin" else _read_cameras_txt(cameras_file)
        ):
            camera_models[key] = _colmap_camera(cameras_file, kind, width, height, values)
        poses = list(_read_images_bin(images_file) if suffix == ".bin" else _read_images_txt(images_file))
    except OSError as error:
        raise ScanError(f"{model}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ScanError(
            f"{model}: cameras{suffix} or images{suffix} is not a text file of COLMAP; export the model again"
        ) from error
    items = []
    for quat_wxyz, translation, camera_id, name in poses:
        if camera_id not in camera_models:
            raise ScanError(f"{images_file}: {quoted(name)} has camera {camera_id}, which {cameras_file.name} does not have")
        T = np.eye(4)
        T[:3, :3] = matrix_from_quat((*quat_wxyz[1:], quat_wxyz[0]))
        T[:3, 3] = translation
        items.append((name, Photograph(_find_image(images_file, folder, name), camera_models[camera_id], invert(T))))
    warning = "COLMAP's scale is arbitrary: the mesh must have the same scale, and the scene is as large as that says"
    return without_lost_poses(
        folder, "colmap", [item for _, item in sorted(items, key=lambda pair: pair[0])], longest_side, (warning,)
    )


def _find_image(images_file: Path, folder: Path, name: str) -> Path:
    paths = [_resolve_inside(str(images_file), folder, f"{place}/{name}" if place else name) for place in _IMAGE_FOLDERS]
    return next((p for p in paths if is_file(p)), paths[0])


def _colmap_camera(path: Path, model: str, width: int, height: int, parameters: list[float]) -> CameraModel:
    if model in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        fx, fy, cx, cy, distortion = parameters[0], parameters[0], parameters[1], parameters[2], parameters[3:]
    elif model in _CAMERA_MODELS:
        fx, fy, cx, cy, distortion = parameters[0], parameters[1], parameters[2], parameters[3], parameters[4:]
    else:
        raise ScanError(
            f"{path}: camera model {quoted(model)} is unknown; known: {', '.join(_CAMERA_MODELS)}; undistort the photographs with COLMAP"
        )
    if model in ("SIMPLE_RADIAL", "RADIAL"):
        distortion = [*distortion, 0.0, 0.0, 0.0][:4] if model == "SIMPLE_RADIAL" else [*distortion, 0.0, 0.0]
    return CameraModel(
        intrinsics_of(str(path), width, height, fx, fy, cx - _PIXEL_CENTRE, cy - _PIXEL_CENTRE),
        tuple(distortion),
        fisheye=model == "OPENCV_FISHEYE",
    )


def _read_cameras_txt(path: Path) -> Iterator[tuple[int, str, int, int, list[float]]]:
    for number, line in enumerate(read_file(path).decode("utf-8").splitlines(), 1):
        words = line.split()
        if not words or words[0].startswith("#"):
            continue
        try:
            key, model, width, height, values = (
                int(words[0]),
                words[1],
                int(words[2]),
                int(words[3]),
                [float(w) for w in words[4:]],
            )
        except (ValueError, IndexError) as error:
            raise ScanError(
                f"{path}:{number}: {quoted(line[:80])} must be camera id, model, width, height and parameters; export the model again"
            ) from error
        if model in _CAMERA_MODELS and len(values) != _CAMERA_MODELS[model][1]:
            raise ScanError(
                f"{path}:{number}: a camera {model} has {len(values)} parameters, must have {_CAMERA_MODELS[model][1]}"
            )
        yield key, model, width, height, values


def _read_images_txt(path: Path) -> Iterator[tuple[list[float], list[float], int, str]]:
    lines = enumerate(read_file(path, _MAX_BYTES).decode("utf-8").splitlines(), 1)
    # Every second line holds the feature points of a photograph, and may be empty.
    for number, line in [(number, line) for number, line in lines if not line.startswith("#")][::2]:
        words = line.split(maxsplit=9)
        if not words:
            continue
        try:
            yield [float(w) for w in words[1:5]], [float(w) for w in words[5:8]], int(words[8]), words[9].strip()
        except (ValueError, IndexError) as error:
            raise ScanError(
                f"{path}:{number}: {quoted(line[:80])} must be image id, qw qx qy qz, tx ty tz, camera id and file; export the model again"
            ) from error


def _read_cameras_bin(path: Path) -> Iterator[tuple[int, str, int, int, list[float]]]:
    data = read_file(path)
    try:
        yield from _cameras_in(data)
    except struct.error as error:
        raise ScanError(
            f"{path}: ends after {len(data)} bytes, within a camera; it is truncated: copy or export it again"
        ) from error


def _cameras_in(data: bytes) -> Iterator[tuple[int, str, int, int, list[float]]]:
    names = {number: name for name, (number, _) in _CAMERA_MODELS.items()}
    offset = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        key, number, width, height = struct.unpack_from("<iiQQ", data, offset)
        name = names.get(number, f"number {number}")
        if name not in _CAMERA_MODELS:
            yield key, name, width, height, []
        count = _CAMERA_MODELS[name][1]
        yield key, name, width, height, list(struct.unpack_from(f"<{count}d", data, offset + 24))
        offset += 24 + 8 * count


def _read_images_bin(path: Path) -> Iterator[tuple[list[float], list[float], int, str]]:
    data = read_file(path, _MAX_BYTES)
    try:
        yield from _images_in(data)
    except (struct.error, ValueError) as error:
        raise ScanError(
            f"{path}: ends after {len(data)} bytes, within an image; it is truncated: copy or export it again"
        ) from error


def _images_in(data: bytes) -> Iterator[tuple[list[float], list[float], int, str]]:
    offset = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        _, *pose, camera = struct.unpack_from("<I7di", data, offset)
        end = data.index(b"\0", offset + 64)
        (points,) = struct.unpack_from("<Q", data, end + 1)
        yield pose[:4], pose[4:], camera, data[offset + 64 : end].decode("utf-8")
        offset = end + 9 + 24 * points
