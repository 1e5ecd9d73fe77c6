"""Finds posed photographs in folders of known layouts: posed RGB-D (ours, Open3D, 7-Scenes, TUM), COLMAP's models,
nerfstudio's transforms.json, raw data of Polycam.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.geometry.transforms import invert, matrix_from_quat
from gibson_sim.quoting import quoted
from gibson_sim.reading import is_file, is_folder, read_file
from gibson_sim_tools.photographs.phone_layouts import polycam, polycam_cameras, record3d, record3d_images
from gibson_sim_tools.photographs.photographs import Lens, Photograph, Photographs, posed
from gibson_sim_tools.scanning.layouts import LAYOUTS, open_posed_rgbd, read_json
from gibson_sim_tools.scanning.pose_conventions import OPTICAL_OPENGL
from gibson_sim_tools.scanning.posed_rgbd import Intrinsics, ScanError

F64 = NDArray[np.float64]

TRANSFORMS = "transforms.json"
_COLMAP_FOLDERS = ("", "sparse/0", "sparse", "colmap/sparse/0", "dense/sparse")
_IMAGE_FOLDERS = ("images", "", "dense/images")
_IMAGES = (".jpg", ".jpeg", ".png")
_MOST_BYTES = 2 * 2**30
"""Size of a model's file; images.bin holds all points that were found in the photographs."""
_HALF = 0.5
"""COLMAP's and nerfstudio's pixel centres are at halves, ours at whole numbers."""
_BAG = "metadata.yaml"
"""What each folder of rosbag2 has."""
_MODELS = {
    "SIMPLE_PINHOLE": (0, 3), "PINHOLE": (1, 4), "SIMPLE_RADIAL": (2, 4), "RADIAL": (3, 5), "OPENCV": (4, 8),
    "OPENCV_FISHEYE": (5, 8), "FULL_OPENCV": (6, 12),
}  # fmt: skip
"""COLMAP's camera models: number in binary files, and number of parameters."""


def open_photographs(folder: Path, longest: int = 0) -> Photographs:
    """Returns the posed photographs in a folder.

    Args:
        folder: of any known layout.
        longest: longest side that pictures are reduced to, pixels; 0 = not at all.

    Raises:
        ScanError: the folder does not exist, has no known layout, or is incomplete; the message says what is missing.
    """
    if not folder.is_dir():
        raise ScanError(f"{folder}: is not a folder; give the one that contains the photographs and their poses")
    if is_file(folder / TRANSFORMS):
        return _nerfstudio(folder, longest)
    keyframes = polycam_cameras(folder)
    if keyframes is not None:
        return polycam(folder, *keyframes, longest)
    images = record3d_images(folder)
    if images is not None:
        return record3d(folder, images, longest)
    model = next((folder / name for name in _COLMAP_FOLDERS if _colmap_suffix(folder / name)), None)
    if model is not None:
        return _colmap(folder, model, longest)
    if any(layout.looks_like(folder) for layout in LAYOUTS):
        rgbd = open_posed_rgbd(folder)
        lens = Lens(rgbd.intrinsics)
        items = tuple(Photograph(f.color, lens, f.T_world_camera, f.depth, rgbd.depth_scale) for f in rgbd.files)
        return Photographs(folder, rgbd.layout, items, longest, rgbd.warnings)
    if any(p.suffix.lower() in _IMAGES for place in (folder, folder / "images") if is_folder(place) for p in place.iterdir()):
        raise ScanError(
            f"{folder}: has photographs but no poses; COLMAP finds them (colmap automatic_reconstructor), or nerfstudio "
            "(ns-process-data), or export them from a scanning app with its poses (Polycam: raw data; Record3D)"
        )
    if is_file(folder / _BAG):
        raise ScanError(
            f"{folder}: is a bag; make photographs with poses of it first: gibson-sim export {folder} DIR --to nerfstudio"
        )
    known = "; ".join(f"{layout.name}: {layout.files}" for layout in LAYOUTS)
    raise ScanError(
        f"{folder}: unknown layout of posed photographs; known: nerfstudio: {TRANSFORMS}; "
        f"colmap: cameras and images, .txt or .bin, also in sparse/0, and images/; polycam: keyframes/; record3d: metadata.json and rgb/; {known}"
    )


def _nerfstudio(folder: Path, longest: int) -> Photographs:
    path = folder / TRANSFORMS
    values = read_json(path)
    frames = values.get("frames") if isinstance(values, dict) else None
    if not isinstance(frames, list):
        raise ScanError(f"{path}: has no list 'frames'; is it nerfstudio's?")
    lenses: dict[tuple[Any, ...], Lens] = {}
    items = []
    applied = (
        None if values.get("applied_transform") is None else _matrix(f"{path}: applied_transform", values["applied_transform"])
    )
    scale = 1.0 / _number(str(path), values, "depth_unit_scale_factor", 0.001)
    for number, frame in enumerate(frames):
        what = f"{path}: frame {number}"
        if not isinstance(frame, dict) or not isinstance(frame.get("file_path"), str):
            raise ScanError(f"{what}: has no 'file_path'")
        matrix = _matrix(what, frame.get("transform_matrix"))
        lens = _nerfstudio_lens(what, {**values, **frame})
        depth = frame.get("depth_file_path")
        depth = _inside(what, folder, depth) if isinstance(depth, str) else None
        lens = lenses.setdefault((lens.intrinsics, lens.distortion, lens.fisheye), lens)
        items.append(Photograph(_inside(what, folder, frame["file_path"]), lens, matrix @ OPTICAL_OPENGL, depth, scale))
    return posed(folder, "nerfstudio", items, longest, applied=applied)


def _number(what: str, values: Mapping[str, Any], name: str, default: float | None = None) -> float:
    value = values.get(name, default)
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        raise ScanError(f"{what}: {name} is {quoted(value)}, must be a number")
    return float(value)


def _matrix(what: str, given: object) -> F64:
    try:
        matrix = np.array(given, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.zeros(0)
    if matrix.shape not in ((4, 4), (3, 4)):
        raise ScanError(f"{what}: the matrix is {quoted(given)}, must be 4x4 numbers by rows")
    return np.vstack([matrix[:3], [0.0, 0.0, 0.0, 1.0]])


def _nerfstudio_lens(what: str, values: Mapping[str, Any]) -> Lens:
    def number(name: str, default: float | None = None) -> float:
        return _number(what, values, name, default)

    width, height = number("w"), number("h")
    focal = (
        0.5 * width / math.tan(number("camera_angle_x") / 2.0) if "camera_angle_x" in values and "fl_x" not in values else None
    )
    fx = number("fl_x", focal)
    intrinsics = Intrinsics(
        int(width), int(height), fx, number("fl_y", fx), number("cx", width / 2.0) - _HALF, number("cy", height / 2.0) - _HALF
    )
    model = values.get("camera_model", "OPENCV")
    if model == "OPENCV_FISHEYE":
        return Lens(intrinsics, tuple(number(k, 0.0) for k in ("k1", "k2", "k3", "k4")), fisheye=True)
    if model not in ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        raise ScanError(f"{what}: camera_model {quoted(model)} is unknown; known: OPENCV, OPENCV_FISHEYE, PINHOLE")
    return Lens(intrinsics, tuple(number(k, 0.0) for k in ("k1", "k2", "p1", "p2", "k3")))


def _inside(what: str, folder: Path, name: str) -> Path:
    """Returns the file of a name, which must lie in the folder; a name may lack its suffix."""
    path = (folder / name).resolve()
    if not path.is_relative_to(folder.resolve()):
        raise ScanError(f"{what}: {quoted(name)} lies outside the folder; files must be named relative to it")
    return next((p for p in (path, path.with_name(path.name + ".png")) if is_file(p)), path)


def _colmap_suffix(model: Path) -> str:
    """Returns the suffix of the files of a model in a folder; empty = there is none."""
    return next((s for s in (".bin", ".txt") if all(is_file(model / f"{name}{s}") for name in ("cameras", "images"))), "")


def _colmap(folder: Path, model: Path, longest: int) -> Photographs:
    suffix = _colmap_suffix(model)
    cameras, images = model / f"cameras{suffix}", model / f"images{suffix}"
    lenses: dict[int, Lens] = {}
    try:
        for key, kind, width, height, values in _cameras_bin(cameras) if suffix == ".bin" else _cameras_txt(cameras):
            lenses[key] = _colmap_lens(cameras, kind, width, height, values)
        poses = list(_images_bin(images) if suffix == ".bin" else _images_txt(images))
    except OSError as error:
        raise ScanError(f"{model}: cannot be read: {error.strerror or error}") from error
    except (struct.error, ValueError, IndexError) as error:
        raise ScanError(f"{model}: is not a COLMAP model, or is truncated ({error}); export it again") from error
    items = []
    for quat_wxyz, shift, camera, name in poses:
        if camera not in lenses:
            raise ScanError(f"{images}: {quoted(name)} has camera {camera}, which {cameras.name} does not have")
        T = np.eye(4)
        T[:3, :3] = matrix_from_quat((*quat_wxyz[1:], quat_wxyz[0]))
        T[:3, 3] = shift
        items.append((name, Photograph(_image(images, folder, name), lenses[camera], invert(T))))
    warning = "COLMAP's scale is arbitrary: the mesh must have the same scale, and the scene is as large as that says"
    return posed(folder, "colmap", [item for _, item in sorted(items, key=lambda pair: pair[0])], longest, (warning,))


def _image(images: Path, folder: Path, name: str) -> Path:
    places = [_inside(str(images), folder, f"{place}/{name}" if place else name) for place in _IMAGE_FOLDERS]
    return next((p for p in places if is_file(p)), places[0])


def _colmap_lens(path: Path, kind: str, width: int, height: int, v: list[float]) -> Lens:
    if kind in ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL"):
        fx, fy, cx, cy, rest = v[0], v[0], v[1], v[2], v[3:]
    elif kind in _MODELS:
        fx, fy, cx, cy, rest = v[0], v[1], v[2], v[3], v[4:]
    else:
        raise ScanError(
            f"{path}: camera model {quoted(kind)} is unknown; known: {', '.join(_MODELS)}; undistort the photographs with COLMAP"
        )
    if kind in ("SIMPLE_RADIAL", "RADIAL"):
        rest = [*rest, 0.0, 0.0, 0.0][:4] if kind == "SIMPLE_RADIAL" else [*rest, 0.0, 0.0]
    return Lens(Intrinsics(width, height, fx, fy, cx - _HALF, cy - _HALF), tuple(rest), fisheye=kind == "OPENCV_FISHEYE")


def _cameras_txt(path: Path) -> Iterator[tuple[int, str, int, int, list[float]]]:
    for line in read_file(path).decode("utf-8").splitlines():
        words = line.split()
        if words and not words[0].startswith("#"):
            yield int(words[0]), words[1], int(words[2]), int(words[3]), _checked(words[1], [float(w) for w in words[4:]])


def _images_txt(path: Path) -> Iterator[tuple[list[float], list[float], int, str]]:
    lines = [line for line in read_file(path, _MOST_BYTES).decode("utf-8").splitlines() if not line.startswith("#")]
    # Each second line holds the points of a photograph, and may be empty.
    for line in lines[::2]:
        words = line.split(maxsplit=9)
        if words:
            yield [float(w) for w in words[1:5]], [float(w) for w in words[5:8]], int(words[8]), words[9].strip()


def _cameras_bin(path: Path) -> Iterator[tuple[int, str, int, int, list[float]]]:
    data = read_file(path)
    names = {number: name for name, (number, _) in _MODELS.items()}
    at = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        key, number, width, height = struct.unpack_from("<iiQQ", data, at)
        name = names.get(number, f"number {number}")
        if name not in _MODELS:
            yield key, name, width, height, []
        count = _MODELS[name][1]
        yield key, name, width, height, list(struct.unpack_from(f"<{count}d", data, at + 24))
        at += 24 + 8 * count


def _images_bin(path: Path) -> Iterator[tuple[list[float], list[float], int, str]]:
    data = read_file(path, _MOST_BYTES)
    at = 8
    for _ in range(struct.unpack_from("<Q", data)[0]):
        _, *pose, camera = struct.unpack_from("<I7di", data, at)
        end = data.index(b"\0", at + 64)
        (points,) = struct.unpack_from("<Q", data, end + 1)
        yield pose[:4], pose[4:], camera, data[at + 64 : end].decode("utf-8")
        at = end + 9 + 24 * points


def _checked(kind: str, values: list[float]) -> list[float]:
    if kind in _MODELS and len(values) != _MODELS[kind][1]:
        raise ValueError(f"a camera {kind} has {len(values)} parameters, must have {_MODELS[kind][1]}")
    return values
