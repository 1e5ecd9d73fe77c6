"""Finds and reads the camera intrinsics of an image set in common formats."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gibson_sim.errors import GibsonSimError, TextError
from gibson_sim.quoting import quoted
from gibson_sim.reading import MAX_YAML_BYTES, is_file, is_folder, parse_yaml, read_file
from gibson_sim.writing import write_file
from gibson_sim_tools.scanning.posed_images import Intrinsics, ScanError

INTRINSIC_FILES = ("intrinsic.json", "camera_intrinsic.json", "intrinsics.json", "camera_intrinsics.json")
"""File names with priority."""
_NAME_PATTERN = re.compile(r"(intrinsic|calib|camera|kinect|^(depth_?)?k\.txt$|^_?info\.txt$|.*\.info\.txt$)", re.IGNORECASE)
_SUFFIXES = (".json", ".txt", ".yaml", ".yml")
_FOLDERS = ("", "intrinsic", "intrinsics", "camera", "calibration")
_MATRIX_KEYS = ("intrinsic_matrix", "camera_matrix", "cameraMatrix", "K", "k")
_FOCAL_KEYS = ("fx", "fy", "cx", "cy")
_NO_MATRIX = "no intrinsics are in it: neither fx, fy, cx, cy nor a matrix of 3x3 or 4x4 numbers"
_NAMED_NUMBER = re.compile(r"\b(fx|fy|cx|cy|width|height)\s*[:=]\s*([-+.\deE]+)", re.IGNORECASE)
_OPENCV = re.compile(rb"\A%YAML:1\.0[^\n]*|!!opencv-\w+")
_NUMBER = re.compile(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?")


def find_intrinsics(folder: Path, width: int, height: int) -> tuple[Intrinsics | None, str, tuple[str, ...]]:
    """Returns the intrinsics in a folder, the name of their file, and a warning for each candidate that could not be read.

    Args:
        folder: of the set; its folders ``intrinsic``, ``camera`` etc. are searched too.
        width: of the depth images, pixels; assumed for files that name no size.
        height: of the depth images, pixels.

    Raises:
        ScanError: a file named after intrinsics holds none.
    """
    warnings = []
    for path in _candidate_files(folder):
        name = path.relative_to(folder).as_posix()
        try:
            found = _read_file(path, width, height)
        except (GibsonSimError, TextError, OSError, ValueError, TypeError, RecursionError, OverflowError) as error:
            text = str(error) if isinstance(error, GibsonSimError) else _NO_MATRIX
            if path.name in INTRINSIC_FILES:
                raise ScanError(text if text.startswith(str(path)) else f"{path}: {text}") from error
            warnings.append(f"{name} is not read: {text}; --intrinsics fx,fy,cx,cy says what the camera is")
            continue
        _check_principal_point(path, found)
        return found, name, tuple(warnings)
    return None, "", tuple(warnings)


def _check_principal_point(path: Path, intrinsics: Intrinsics) -> None:
    """Raises ScanError if the principal point is outside the central half of the image: the file is for images of another size."""
    size, point = (intrinsics.width, intrinsics.height), (intrinsics.cx, intrinsics.cy)
    if any(not 0.25 <= c / s <= 0.75 for c, s in zip(point, size, strict=True)):
        likely = "x".join(str(round(2.0 * c + 1.0)) for c in point)
        raise ScanError(
            f"{path}: the principal point is at {point[0]:g}, {point[1]:g} pixels, far from the middle of images of {size[0]}x{size[1]}; are these "
            f"the intrinsics of images of {likely}? Give those of {size[0]}x{size[1]}, also with --intrinsics fx,fy,cx,cy"
        )


def _candidate_files(folder: Path) -> list[Path]:
    """Returns candidate files: Open3D's names first, depth cameras before others."""
    preferred = [folder / name for name in INTRINSIC_FILES if is_file(folder / name)]
    folders = [folder / name if name else folder for name in _FOLDERS]
    others = [
        p
        for place in folders if is_folder(place)
        for p in sorted(place.iterdir())
        if p.suffix.lower() in _SUFFIXES and is_file(p) and _NAME_PATTERN.search(p.name) and "extrinsic" not in p.name.lower() and p not in preferred
    ]  # fmt: skip
    return preferred + sorted(others, key=lambda p: ("intrinsic" not in p.name.lower(), "depth" not in p.name.lower()))


def _read_file(path: Path, width: int, height: int) -> Intrinsics:
    suffix = path.suffix.lower()
    if suffix == ".txt":
        return _parse_text(path, width, height)
    values = json.loads(read_file(path)) if suffix == ".json" else _read_yaml(path)
    if isinstance(values, dict) and isinstance(values.get("intrinsic"), dict):
        values = values["intrinsic"]
    if not isinstance(values, dict):
        raise ScanError(_NO_MATRIX)
    size = [values.get(a, values.get(b)) for a, b in (("width", "image_width"), ("height", "image_height"))]
    if any(isinstance(s, bool) or not isinstance(s, int) for s in size if s is not None):
        raise ScanError(f"width and height are {quoted(size)}, must be whole numbers of pixels")
    image_width, image_height = (
        int(given) if given is not None else of_image for given, of_image in zip(size, (width, height), strict=True)
    )
    if all(name in values for name in _FOCAL_KEYS):
        return Intrinsics(image_width, image_height, *(float(values[name]) for name in _FOCAL_KEYS))
    key = next((name for name in _MATRIX_KEYS if name in values), "")
    if not key:
        raise ScanError(_NO_MATRIX)
    value = values[key]
    value = value.get("data") if isinstance(value, dict) else value
    numbers = np.asarray(value, dtype=np.float64).ravel().tolist()
    return _from_matrix(numbers, image_width, image_height)


def _read_yaml(path: Path) -> object:
    """Returns the values of a YAML file, also of OpenCV's dialect."""
    return parse_yaml(_OPENCV.sub(b"", read_file(path, MAX_YAML_BYTES)))


def _parse_text(path: Path, width: int, height: int) -> Intrinsics:
    """Returns the intrinsics in a text: fx fy cx cy, also with names or after width and height; the rows of a matrix; or a line
    ``intrinsic = MATRIX``.
    """
    text = read_file(path).decode("utf-8", errors="replace")
    lines = [line.partition("#")[0].strip() for line in text.splitlines()]
    named = [line.partition("=") for line in lines if "=" in line and "ntrinsic" in line.partition("=")[0]]
    if named:
        _, _, values = min(named, key=lambda parts: "epth" not in parts[0])
        return _from_matrix([float(word) for word in _NUMBER.findall(values)], width, height)
    pairs = {name.lower(): float(value) for line in lines for name, value in _NAMED_NUMBER.findall(line)}
    if all(name in pairs for name in _FOCAL_KEYS):
        size = int(pairs.get("width", width)), int(pairs.get("height", height))
        return Intrinsics(*size, *(pairs[name] for name in _FOCAL_KEYS))
    numbers = [float(word) for line in lines for word in line.replace(",", " ").split()]
    if len(numbers) == 4:
        return Intrinsics(width, height, *numbers)
    if len(numbers) == 6 and all(n.is_integer() and n > 0 for n in numbers[:2]):
        return Intrinsics(int(numbers[0]), int(numbers[1]), *numbers[2:])
    return _from_matrix(numbers, width, height)


def _from_matrix(numbers: Sequence[float], width: int, height: int) -> Intrinsics:
    """Returns the intrinsics in a 3x3, 3x4 or 4x4 matrix, by rows, or by columns as Open3D writes them.

    Raises:
        ScanError: it is no intrinsic matrix, or is for larger images.
    """
    shape = {9: (3, 3), 12: (3, 4), 16: (4, 4)}.get(len(numbers))
    if shape is None:
        raise ScanError(_NO_MATRIX)
    matrix = np.array(numbers, dtype=np.float64).reshape(shape)[:3, :3]
    m = next(
        (m for m in (matrix, matrix.T) if np.allclose((m[0, 1], m[1, 0], *m[2]), (0.0, 0.0, 0.0, 0.0, 1.0), atol=1e-9)), None
    )
    if m is None:
        raise ScanError(f"its matrix is {quoted(matrix.ravel().tolist())}, must be fx 0 cx 0 fy cy 0 0 1, pixels")
    if not (0.0 <= m[0, 2] <= width and 0.0 <= m[1, 2] <= height):
        raise ScanError(f"its middle is at {m[0, 2]:g}, {m[1, 2]:g} pixels, outside an image of {width}x{height}")
    return Intrinsics(width, height, float(m[0, 0]), float(m[1, 1]), float(m[0, 2]), float(m[1, 2]))


def write_intrinsics(path: Path, intrinsics: Intrinsics) -> None:
    """Writes intrinsics in Open3D's format."""
    columns = [float(value) for value in intrinsics.matrix.T.ravel()]
    values = {"width": intrinsics.width, "height": intrinsics.height, "intrinsic_matrix": columns}
    write_file(path, json.dumps(values, indent=1) + "\n")
