"""Opens posed RGB-D in folders of known layouts, which are detected: ours, Open3D, 7-Scenes, TUM.

A layout has a function that recognises a folder and one that reads it. The first layout that recognises the folder reads it, and either
returns the set or says what is missing.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from gibson_sim_tools.scanning.intrinsics_files import INTRINSIC_FILES, find_intrinsics
from gibson_sim_tools.scanning.posed_images import (
    CameraModel,
    Intrinsics,
    Photograph,
    Photographs,
    PosedRgbd,
    ScanError,
    check_pose,
    read_image,
)
from gibson_sim_tools.scanning.trajectories import (
    associate,
    parse_numbers,
    pose_at,
    read_lines,
    read_stamped_poses,
    read_trajectory_log,
)

F64 = NDArray[np.float64]

DESCRIPTION = "scan.json"
"""File that marks our scans."""
FORMAT = "gibson_sim scan"
TIME_TOLERANCE_S = 0.02
"""TUM: largest time difference between associated colour, depth and pose, seconds."""
_IMAGE_SUFFIXES = (".jpg", ".jpeg", ".png")
_COLOR_FOLDERS = ("color", "image", "rgb")
_LOG_FILES = ("trajectory.log", "scene/trajectory.log", "test_scene/trajectory.log")
_PRIMESENSE = Intrinsics(640, 480, 525.0, 525.0, 319.5, 239.5)
_SEVEN_SCENES = Intrinsics(640, 480, 585.0, 585.0, 320.0, 240.0)
_SEVEN_SCENES_FRAME = re.compile(r"frame-(\d+)\.(color|depth|pose)\.(png|jpg|txt)$")
_ASSOCIATIONS = ("associations.txt", "associate.txt")
_PHOTOGRAPH_LAYOUTS = {"transforms.json": "nerfstudio", "keyframes": "polycam", "sparse": "colmap"}
"""File or folder -> layout of posed photographs that it marks, for messages."""
_MILLIMETRES, _TUM_SCALE = 1000.0, 5000.0


_Frame = tuple[Path, Path, F64]
"""Colour image, depth image, T_world_camera."""


@dataclass(frozen=True, slots=True)
class _Overrides:
    """Values of the caller that replace those of the folder."""

    focal: tuple[float, float, float, float] | None
    """fx, fy, cx, cy, pixels."""
    depth_scale: float | None


@dataclass(frozen=True, slots=True)
class FolderLayout:
    """One layout of posed RGB-D in a folder."""

    name: str
    files: str
    """Its files, as text for messages."""
    recognises: Callable[[Path], bool]
    read: Callable[[Path, _Overrides], PosedRgbd]


def open_posed_rgbd(
    folder: Path, *, focal: tuple[float, float, float, float] | None = None, depth_scale: float | None = None
) -> PosedRgbd:
    """Returns the posed RGB-D in a folder of any known layout; images are decoded on access.

    Args:
        folder: the folder.
        focal: fx, fy, cx, cy in pixels; replaces the value of the folder or the layout.
        depth_scale: units of the depth images per metre; replaces the value of the layout.

    Raises:
        ScanError: the folder does not exist, has no known layout, or is incomplete; the message says what is missing.
    """
    if not folder.is_dir():
        raise ScanError(f"{folder}: is not a folder; give the one that holds the images and poses")
    for layout in LAYOUTS:
        if layout.recognises(folder):
            return layout.read(folder, _Overrides(focal, depth_scale))
    other = next((name for file, name in _PHOTOGRAPH_LAYOUTS.items() if (folder / file).exists()), "")
    if other:
        raise ScanError(
            f"{folder}: is a folder of photographs ({other}), which `scene fuse` does not read; `gibson-sim scene import` "
            "fuses its depth images, if any"
        )
    known = "; ".join(f"{layout.name}: {layout.files}" for layout in LAYOUTS)
    inside = sorted(p.name for p in folder.iterdir() if p.is_dir() and any(layout.recognises(p) for layout in LAYOUTS))
    if inside:
        raise ScanError(f"{folder}: holds several sets, give one of its folders: {', '.join(inside[:8])}")
    raise ScanError(f"{folder}: unknown layout of posed RGB-D; known: {known}")


def _read_ours(folder: Path, options: _Overrides) -> PosedRgbd:
    description = read_json(folder / DESCRIPTION)
    count = description.get("frames") if isinstance(description, dict) and description.get("format") == FORMAT else None
    if not isinstance(count, int):
        raise ScanError(f"{folder / DESCRIPTION}: is not the description of a scan; its format must be {FORMAT!r}")
    color, depth = _image_files(folder / "color"), _image_files(folder / "depth")
    if len(color) != count or len(depth) != count:
        raise ScanError(
            f"{folder}: has {len(color)} colour and {len(depth)} depth images of {count}; "
            "the scan was interrupted: run the same `gibson-sim scene scan` again to finish it"
        )
    _, poses = read_stamped_poses(folder / "poses.txt")
    return _with_intrinsics(folder, "gibson_sim", _match_by_order(folder, color, depth, poses), options, None, _MILLIMETRES)


def _read_open3d(folder: Path, options: _Overrides) -> PosedRgbd:
    color = _image_files(next(folder / name for name in _COLOR_FOLDERS if (folder / name).is_dir()))
    log = next((folder / name for name in _LOG_FILES if (folder / name).is_file()), None)
    if log is None:
        raise ScanError(f"{folder}: has images but no poses; looked for {', '.join(_LOG_FILES)}")
    files = _match_by_order(folder, color, _image_files(folder / "depth"), read_trajectory_log(log))
    return _with_intrinsics(folder, "open3d", files, options, _PRIMESENSE, _MILLIMETRES)


def _read_seven_scenes(folder: Path, options: _Overrides) -> PosedRgbd:
    frames: dict[int, dict[str, Path]] = {}
    for path in folder.iterdir():
        match = _SEVEN_SCENES_FRAME.match(path.name)
        if match:
            frames.setdefault(int(match[1]), {})[match[2]] = path
    files = []
    for number, parts in sorted(frames.items()):
        missing = [kind for kind in ("color", "depth", "pose") if kind not in parts]
        if missing:
            raise ScanError(
                f"{folder}: frame {number} has no {' and no '.join(missing)}; "
                f"each needs frame-{number:06d}.color.png, .depth.png and .pose.txt"
            )
        files.append((parts["color"], parts["depth"], _read_matrix(parts["pose"])))
    return _with_intrinsics(folder, "7-scenes", files, options, _SEVEN_SCENES, _MILLIMETRES)


def _read_tum(folder: Path, options: _Overrides) -> PosedRgbd:
    pose_file = folder / "groundtruth.txt"
    if not pose_file.is_file():
        raise ScanError(f"{folder}: has lists of images but no groundtruth.txt with their poses")
    stamps, poses = read_stamped_poses(pose_file)
    pairs = _tum_pairs(folder)
    matched = [(pose_at(stamps, poses, stamp, TIME_TOLERANCE_S), color, depth) for stamp, color, depth in pairs]
    files = [(color, depth, pose) for pose, color, depth in matched if pose is not None]
    if not files:
        raise ScanError(
            f"{pose_file}: has no pose within {TIME_TOLERANCE_S:g} s of any of the {len(pairs)} pairs of images; "
            "are its stamps of the same clock?"
        )
    unmatched = len(pairs) - len(files)
    warnings = (f"{unmatched} of {len(pairs)} pairs of images have no pose near in time and are left out",) if unmatched else ()
    return _with_intrinsics(folder, "tum", files, options, _PRIMESENSE, _TUM_SCALE, warnings)


def _tum_pairs(folder: Path) -> list[tuple[float, Path, Path]]:
    """Returns stamp of the colour image, colour image and depth image."""
    associations = next((folder / name for name in _ASSOCIATIONS if (folder / name).is_file()), None)
    if associations is not None:
        return [_tum_association(associations, number, line.split()) for number, line in read_lines(associations)]
    color, depth = (_tum_list(folder / name) for name in ("rgb.txt", "depth.txt"))
    pairs = associate([stamp for stamp, _ in color], [stamp for stamp, _ in depth], TIME_TOLERANCE_S)
    if not len(pairs):
        raise ScanError(
            f"{folder}: no image of rgb.txt is within {TIME_TOLERANCE_S:g} s of one of depth.txt; are their stamps of the same clock?"
        )
    return [(color[i][0], color[i][1], depth[j][1]) for i, j in pairs]


def _tum_association(path: Path, number: int, words: list[str]) -> tuple[float, Path, Path]:
    if len(words) != 4:
        raise ScanError(
            f"{path}:{number}: {' '.join(words)[:80]!r} must be stamp and file of the colour image, stamp and file of the depth image"
        )
    stamps = [parse_numbers(path, number, [words[k]], 1, "a stamp, seconds")[0] for k in (0, 2)]
    files = [_resolve_inside(path, number, words[k]) for k in (1, 3)]
    # The script that writes the file keeps the order of its arguments, so that either may come first.
    first = 1 if "depth" in words[1].lower() and "depth" not in words[3].lower() else 0
    return stamps[first], files[first], files[1 - first]


def _tum_list(path: Path) -> list[tuple[float, Path]]:
    rows = []
    for number, line in read_lines(path):
        stamp, _, name = line.partition(" ")
        if not name:
            raise ScanError(f"{path}:{number}: {line[:80]!r} must be a stamp, seconds, and the name of a file")
        rows.append(
            (
                parse_numbers(path, number, [stamp], 1, "a stamp, seconds, and the name of a file")[0],
                _resolve_inside(path, number, name),
            )
        )
    return rows


def _resolve_inside(path: Path, number: int, name: str) -> Path:
    """Returns the path of a listed file, relative to the folder of the list.

    Raises:
        ScanError: the path leads out of the folder.
    """
    named = Path(name.strip())
    if named.is_absolute() or ".." in named.parts:
        raise ScanError(f"{path}:{number}: {name[:80]!r} lies outside the folder; files must be named relative to it")
    return path.parent / named


def _match_by_order(folder: Path, color: Sequence[Path], depth: Sequence[Path], poses: F64) -> list[_Frame]:
    """Returns the frames, with images and poses matched by their order.

    Raises:
        ScanError: the counts differ.
    """
    if not len(color) == len(depth) == len(poses):
        raise ScanError(
            f"{folder}: has {len(color)} colour images, {len(depth)} depth images and {len(poses)} poses; there must be as many of each"
            f"{_first_missing(color, depth, len(poses))}"
        )
    return list(zip(color, depth, poses, strict=True))


def _first_missing(color: Sequence[Path], depth: Sequence[Path], poses: int) -> str:
    """Returns the first frame that lacks a file or a pose, as text; empty if names do not tell."""
    names = {path.stem for path in color}, {path.stem for path in depth}
    for stem in sorted(names[0] ^ names[1]) if names[0] & names[1] else ():
        has, lacks = ("colour", "depth") if stem in names[0] else ("depth", "colour")
        return f": frame {stem} has a {has} image, but no {lacks} image"
    if poses < len(color):
        return f": the poses end before {color[poses].name}"
    return f": there is no image for pose {len(color)}, counted from 0" if len(color) < poses else ""


def _with_intrinsics(
    folder: Path, layout: str, frames: Sequence[_Frame], options: _Overrides, assumed: Intrinsics | None, depth_scale: float,
    warnings: tuple[str, ...] = (),
) -> PosedRgbd:  # fmt: skip
    """Returns the set with its intrinsics: those of the caller, else of a file in the folder, else of the layout's usual camera."""
    if not frames:
        raise ScanError(f"{folder}: has no frame")
    height, width = read_image(frames[0][1], cv2.IMREAD_UNCHANGED).shape[:2]
    ignored: tuple[str, ...] = ()
    if options.focal is not None:
        intrinsics = Intrinsics(width, height, *options.focal)
    else:
        found, file, ignored = find_intrinsics(folder, width, height)
        warnings = (*warnings, *ignored)
        resolved = found or assumed
        if resolved is None:
            raise ScanError(f"{folder}: has no {INTRINSIC_FILES[0]}; add it, or give --intrinsics fx,fy,cx,cy")
        intrinsics = resolved
        text = f"fx {intrinsics.fx:g} fy {intrinsics.fy:g} cx {intrinsics.cx:g} cy {intrinsics.cy:g}"
        if found is None:
            warnings = (*warnings, f"has no {INTRINSIC_FILES[0]}: took those of the {layout} camera, {text}")
        elif file not in INTRINSIC_FILES:
            warnings = (*warnings, f"intrinsics are those of {file}: {text}")
    if (intrinsics.width, intrinsics.height) != (width, height):
        raise ScanError(
            f"{frames[0][1]}: has {width}x{height} pixels, the intrinsics are for {intrinsics.width}x{intrinsics.height}; "
            + "; ".join(("give those of this size with --intrinsics fx,fy,cx,cy", *(f"{folder}/{line}" for line in ignored)))
        )
    camera, scale = CameraModel(intrinsics), options.depth_scale or depth_scale
    items = tuple(Photograph(color, camera, pose, depth, scale) for color, depth, pose in frames)
    return PosedRgbd(Photographs(folder, layout, items, warnings=warnings), intrinsics)


def _read_matrix(path: Path) -> F64:
    rows = read_lines(path)
    if len(rows) != 4:
        raise ScanError(f"{path}: has {len(rows)} lines, must have the four rows of a 4x4 matrix")
    pose = np.array([parse_numbers(path, n, line.split(), 4, "the four numbers of a row of a matrix") for n, line in rows])
    check_pose(str(path), pose)
    return pose


def read_json(path: Path) -> Any:
    """Returns the content of a JSON file.

    Raises:
        ScanError: it cannot be read, or is no JSON.
    """
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror or error}") from error
    except (ValueError, RecursionError) as error:
        raise ScanError(f"{path}: is not JSON: {error}") from error


def _image_files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.iterdir() if p.suffix.lower() in _IMAGE_SUFFIXES) if folder.is_dir() else []


def _has_images(folder: Path) -> bool:
    return (folder / "depth").is_dir() and any((folder / name).is_dir() for name in _COLOR_FOLDERS)


def _has_lists(folder: Path) -> bool:
    lists = all((folder / name).is_file() for name in ("rgb.txt", "depth.txt"))
    return lists or any((folder / name).is_file() for name in _ASSOCIATIONS)


LAYOUTS: tuple[FolderLayout, ...] = (
    FolderLayout(
        "gibson_sim", f"{DESCRIPTION}, color/, depth/, poses.txt, intrinsic.json",
        lambda folder: (folder / DESCRIPTION).is_file(), _read_ours,
    ),
    FolderLayout(
        "7-scenes", "frame-000000.color.png, frame-000000.depth.png, frame-000000.pose.txt",
        lambda folder: any(_SEVEN_SCENES_FRAME.match(p.name) for p in folder.glob("frame-*")), _read_seven_scenes,
    ),
    FolderLayout("tum", "rgb.txt and depth.txt (or associations.txt), groundtruth.txt", _has_lists, _read_tum),
    FolderLayout("open3d", "color/ or image/ or rgb/, depth/, trajectory.log (also in scene/)", _has_images, _read_open3d),
)  # fmt: skip
"""Layouts in the order of detection."""
