"""Reads and writes a path as a folder: ``path.yaml``, ``nodes.csv``, ``velocities.csv`` and one PNG for each image of each node.

::

    kitchen/
      path.yaml        format: 1, camera, hfov_deg, spacing_m, nodes (their number), width, height
      nodes.csv        node,stamp_ns,distance_m,x_m,y_m,yaw_rad     (the last three are empty if the path has no odometry)
      velocities.csv   node,after_ns,linear_mps,angular_radps       (what was driven from a node on; after_ns after its stamp)
      images/000000_front.png  [images/000000_back.png]             (PNG, 8 bits, RGB)
"""

from __future__ import annotations

import csv
import hashlib
import io
import logging
import math
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, cast

import cv2
import numpy as np
import yaml

from gibson_path_following.errors import PathFolderError, quoted
from gibson_path_following.images.image_header import image_size
from gibson_path_following.paths.folder_lock import FolderLock
from gibson_path_following.types import IMAGES_OF, CameraKind, Image, PathNode, RecordedPath, Velocity

_log = logging.getLogger(__name__)
FORMAT = 1
"""Version of the folder's format."""
SETTINGS_FILE, NODES_FILE, VELOCITIES_FILE, IMAGES_FOLDER = "path.yaml", "nodes.csv", "velocities.csv", "images"
MAX_NODES = 20_000
"""Nodes of a path: 4 km at 0.2 m."""
MAX_SIDE = 4096
"""Width and height of an image, pixels."""
MAX_PIXELS = 2**30
"""Pixels of all images of a path, which are kept in memory."""
MAX_VELOCITIES = 1_000_000
"""Velocities of a path."""
MAX_VALUE = 1e8
"""Largest distance, coordinate, yaw or velocity, metres and radians."""
_MAX_ROW_BYTES = 160
"""Bytes of a row, on average: six numbers of 25 digits."""
_MAX_IMAGE_BYTES = 64 * 2**20
_KEYS = ("format", "camera", "hfov_deg", "spacing_m", "nodes", "width", "height")
_NODE_COLUMNS = ("node", "stamp_ns", "distance_m", "x_m", "y_m", "yaw_rad")
_VELOCITY_COLUMNS = ("node", "after_ns", "linear_mps", "angular_radps")
_IMAGE_NAME = re.compile(r"\d{6}_[a-z]+\.png", re.ASCII)
_MAX_COPIES = 1000
"""Number up to which ``new_folder`` counts."""


def image_name(node: int, camera: str) -> str:
    """Returns the name of an image's file below the folder."""
    return f"{IMAGES_FOLDER}/{node:06d}_{camera}.png"


def max_nodes(camera: CameraKind, width: int, height: int) -> int:
    """Returns the largest number of nodes of a path with images of a size, pixels."""
    return min(MAX_NODES, MAX_PIXELS // (width * height * len(IMAGES_OF[camera])))


def save_path(path: RecordedPath, folder: str | Path, *, replace: bool = False) -> None:
    """Writes a path, as ``PathWriter`` does.

    Args:
        path: the path.
        folder: a new folder; ~ is the home folder.
        replace: whether the folder may be one with a path, which is replaced.

    Raises:
        PathFolderError: the folder exists, or cannot be written; or the path cannot be.
    """
    with PathWriter(folder, replace=replace) as writer:
        writer.write(path)


class PathWriter:
    """Writes a path to a folder, which appears complete or not at all; until ``close``, no other writer has that folder."""

    def __init__(self, folder: str | Path, *, replace: bool = False) -> None:
        """Creates the folder that will hold ``folder``, and removes what writers that were killed have left in it.

        Args:
            folder: a new folder; ~ is the home folder.
            replace: whether the folder may be one with a path, which is replaced. It stays if the new one cannot be written.

        Raises:
            PathFolderError: the folder exists, cannot be written, or has another writer.
        """
        self.folder = expanded(folder)
        """The folder of the path."""
        self._replace = replace
        check_folder(self.folder, replace=replace)
        try:
            self._target = target = self.folder.resolve()  # of a link: what it leads to
            # Not its name, which may be as long as the file system allows.
            key = hashlib.sha256(os.fsencode(target.name)).hexdigest()[:8]
            self._draft, self._old, lock = (target.with_name(f".path.{key}.{kind}") for kind in ("part", "old", "lock"))
            target.parent.mkdir(parents=True, exist_ok=True)
            _remove_stale(target.parent)
            self._lock = FolderLock(lock)
        except BlockingIOError as error:
            raise PathFolderError(
                f"cannot write {self.folder}: another recorder has this folder; end that one, or give another folder"
            ) from error
        except (OSError, ValueError) as error:
            raise PathFolderError(f"cannot write {self.folder}: {_reason(error)}; give another folder") from error
        try:
            self._restore_older()
        except BaseException:
            self.close()
            raise

    def write(self, path: RecordedPath) -> None:
        """Writes a path; may be called again if that failed.

        Raises:
            PathFolderError: the path or the folder cannot be written.
        """
        check_path(path, f"cannot write {self.folder}")
        check_folder(self.folder, replace=self._replace)
        try:
            self._draft.mkdir(parents=True)
            try:
                _write(path, self._draft)
                check_folder(self.folder, replace=self._replace)  # images take a while: another program may have been faster
                self._put_in_place()
            finally:
                shutil.rmtree(self._draft, ignore_errors=True)
        except (OSError, ValueError) as error:
            raise PathFolderError(f"cannot write {self.folder}: {_reason(error)}") from error

    def close(self) -> None:
        """Releases the folder; a second call does nothing."""
        self._lock.close()

    def __enter__(self) -> PathWriter:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    def _put_in_place(self) -> None:
        """Renames the draft to the folder; an older path takes the draft's place."""
        if self._target.exists():
            self._target.rename(self._old)
        try:
            self._draft.rename(self._target)
        except OSError:
            if self._old.exists():
                self._old.rename(self._target)
            raise
        if self._old.exists():
            self._old.rename(self._draft)

    def _restore_older(self) -> None:
        """Restores the older path if a writer was killed between the two renamings that replace it.

        Raises:
            PathFolderError: it may not be replaced, or cannot be restored.
        """
        if not self._old.exists():
            return
        try:
            if self._target.exists():
                shutil.rmtree(self._old)
                return
            self._old.rename(self._target)
        except OSError as error:
            raise PathFolderError(f"cannot restore {self.folder} from {self._old}: {_reason(error)}; move that away") from error
        _log.warning("%s: restored the older path, which a recorder that was killed had not replaced yet", self.folder)
        check_folder(self.folder, replace=self._replace)


def _remove_stale(folder: Path) -> None:
    """Removes the drafts and lock files of writers that were killed; those of running ones are locked."""
    for stem in {file.stem for kind in ("part", "lock") for file in folder.glob(f".path.*.{kind}")}:
        try:
            with FolderLock(folder / f"{stem}.lock"):
                shutil.rmtree(folder / f"{stem}.part", ignore_errors=True)
        except OSError:  # locked, or of another user
            continue


def check_folder(folder: str | Path, *, replace: bool = False) -> None:
    """Checks that a path may be written to a folder.

    Args:
        folder: a new folder; ~ is the home folder.
        replace: whether the folder may be one with a path, and nothing else.

    Raises:
        PathFolderError: it exists, holds other files, too, or cannot be written.
    """
    folder = expanded(folder)
    try:
        if folder.exists():
            _check_replaceable(folder, replace)
        parent = folder.resolve().parent
        while not parent.exists():
            parent = parent.parent
        if not parent.is_dir():
            raise PathFolderError(f"cannot write {folder}: {parent} is not a folder; give another folder")
        Path(
            tempfile.mkdtemp(prefix=".path.", dir=parent)
        ).rmdir()  # permissions alone do not tell: the disk may be read-only or full
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links that lead to each other
        raise PathFolderError(f"cannot write {folder}: {_reason(error)}; give another folder") from error


def _check_replaceable(folder: Path, replace: bool) -> None:
    is_path = (folder / SETTINGS_FILE).is_file()
    if not replace:
        hint = ", or set replace to true" if is_path else ""
        raise PathFolderError(f"cannot write {folder}: it exists; give a new folder{hint}")
    if not is_path:
        raise PathFolderError(f"cannot write {folder}: it exists without a path in it; give a new folder")
    of_path = {SETTINGS_FILE, NODES_FILE, VELOCITIES_FILE, IMAGES_FOLDER}
    foreign = [entry.name for entry in folder.iterdir() if entry.name not in of_path]
    if not foreign and (folder / IMAGES_FOLDER).is_dir():
        foreign = [
            f"{IMAGES_FOLDER}/{entry.name}"
            for entry in (folder / IMAGES_FOLDER).iterdir()
            if not _IMAGE_NAME.fullmatch(entry.name)
        ]
    if foreign:
        raise PathFolderError(
            f"cannot write {folder}: it holds {quoted(min(foreign))} besides a path, which would be deleted; move that away, or give a new folder"
        )


def new_folder(folder: str | Path) -> Path:
    """Returns the first of ``folder``-2, -3 and so on that does not exist.

    Raises:
        PathFolderError: there are too many, or it cannot be looked up.
    """
    folder = expanded(folder)
    try:
        target = folder.resolve()
        for number in range(2, _MAX_COPIES):
            copy = target.with_name(f"{target.name}-{number}")
            if not copy.exists():
                return copy
    except (OSError, ValueError, RuntimeError) as error:
        raise PathFolderError(f"cannot write beside {folder}: {_reason(error)}") from error
    raise PathFolderError(f"cannot write beside {folder}: {folder.name}-2 to {folder.name}-{_MAX_COPIES - 1} exist; remove some")


def expanded(folder: str | Path) -> Path:
    """Returns a folder with the home folder for a leading ~."""
    try:
        return Path(folder).expanduser()
    except RuntimeError:  # there is no such user
        return Path(folder)


def load_path(folder: str | Path) -> RecordedPath:
    """Reads a path.

    Args:
        folder: where it was written; ~ is the home folder.

    Raises:
        PathFolderError: the folder holds no path that can be read; the message names the file and the remedy.
    """
    folder = expanded(folder)
    settings = _read_settings(folder / SETTINGS_FILE)
    count: int = settings["nodes"]
    camera = cast("CameraKind", settings["camera"])
    size = (int(settings["width"]), int(settings["height"]))
    rows = _read_rows(folder / NODES_FILE, _NODE_COLUMNS, MAX_NODES)
    if len(rows) != count:
        raise PathFolderError(
            f"{folder / NODES_FILE} has {len(rows)} nodes, but {SETTINGS_FILE} says {count}; record the path again"
        )
    velocities = _read_velocities(folder / VELOCITIES_FILE, count)
    nodes: list[PathNode] = []
    for i, row in enumerate(rows):
        where = f"{folder / NODES_FILE}, line {i + 2}"
        if _whole(where, "node", row[0]) != i:
            raise PathFolderError(f"{where}: node is {quoted(row[0])}, must be {i}; nodes stand in their order, from 0")
        stamp = _whole(where, "stamp_ns", row[1])
        distance = _number(where, "distance_m", row[2])
        if nodes and (stamp <= nodes[-1].stamp_ns or distance < nodes[-1].distance):
            raise PathFolderError(f"{where}: stamp_ns must grow and distance_m must not shrink from node to node")
        pose = None
        if any(text.strip() for text in row[3:]):
            pose = (_number(where, "x_m", row[3]), _number(where, "y_m", row[4]), _number(where, "yaw_rad", row[5]))
        view = tuple(_read_image(folder / image_name(i, name), size) for name in IMAGES_OF[camera])
        nodes.append(PathNode(view, stamp, distance, tuple(velocities[i]), pose))
    return RecordedPath(camera, math.radians(settings["hfov_deg"]), tuple(nodes), float(settings["spacing_m"]))


def check_path(path: RecordedPath, what: str = "the path") -> None:
    """Checks that a path can be written and followed.

    Args:
        path: the path.
        what: begin of the message.

    Raises:
        PathFolderError: it cannot.
    """
    if path.camera not in IMAGES_OF:
        raise PathFolderError(f"{what}: camera is {quoted(path.camera)}, must be one of {', '.join(IMAGES_OF)}")
    if not 2 <= len(path.nodes) <= MAX_NODES:
        raise PathFolderError(f"{what}: a path has 2 to {MAX_NODES} nodes, this one {len(path.nodes)}; drive on while it records")
    shape = path.nodes[0].view[0].shape if path.nodes[0].view else ()
    rows = sum(len(node.velocities) for node in path.nodes)
    if rows > MAX_VELOCITIES:
        raise PathFolderError(f"{what}: a path has at most {MAX_VELOCITIES} velocities, this one {rows}; record shorter ones")
    for i, node in enumerate(path.nodes):
        if len(node.view) != len(IMAGES_OF[path.camera]):
            raise PathFolderError(
                f"{what}: node {i} has {len(node.view)} images, a {path.camera} camera has {len(IMAGES_OF[path.camera])}"
            )
        for image in node.view:
            if image.shape != shape or len(shape) != 3 or shape[2] != 3 or image.dtype != np.uint8:
                raise PathFolderError(
                    f"{what}: an image of node {i} is {image.shape} {image.dtype}, the first one is {shape}; all must be "
                    "(height, width, 3) uint8 of one size"
                )
        if i and (node.stamp_ns <= path.nodes[i - 1].stamp_ns or node.distance < path.nodes[i - 1].distance):
            raise PathFolderError(f"{what}: node {i}: stamps must grow and distances must not shrink from node to node")
        numbers = [("distance", node.distance), *zip(("x", "y", "yaw"), node.pose or (), strict=False)]
        numbers += [("velocity", value) for _, velocity in node.velocities for value in (velocity.linear, velocity.angular)]
        for name, number in numbers:
            if not abs(number) <= MAX_VALUE:
                raise PathFolderError(f"{what}: the {name} of node {i} is {number:g}, must be at most {MAX_VALUE:g}")
    _check_settings(_settings(path), what)


def _settings(path: RecordedPath) -> dict[str, Any]:
    height, width = path.nodes[0].view[0].shape[:2]
    values = (FORMAT, path.camera, round(math.degrees(path.hfov), 6), float(path.spacing), len(path.nodes), width, height)
    return dict(zip(_KEYS, values, strict=True))


def _write(path: RecordedPath, folder: Path) -> None:
    (folder / SETTINGS_FILE).write_text(yaml.safe_dump(_settings(path), sort_keys=False), encoding="utf-8")
    (folder / IMAGES_FOLDER).mkdir()
    rows: list[Sequence[object]] = []
    velocities: list[Sequence[object]] = []
    for i, node in enumerate(path.nodes):
        pose = ("", "", "") if node.pose is None else tuple(repr(float(value)) for value in node.pose)
        rows.append((i, int(node.stamp_ns), repr(float(node.distance)), *pose))
        velocities.extend((i, int(after), repr(float(v.linear)), repr(float(v.angular))) for after, v in node.velocities)
        for name, image in zip(IMAGES_OF[path.camera], node.view, strict=True):
            done, data = cv2.imencode(".png", np.ascontiguousarray(image[..., ::-1]))
            if not done:
                raise ValueError(f"OpenCV cannot write an image of {image.shape[1]}x{image.shape[0]} pixels as PNG")
            (folder / image_name(i, name)).write_bytes(data.tobytes())
    _write_rows(folder / NODES_FILE, _NODE_COLUMNS, rows)
    _write_rows(folder / VELOCITIES_FILE, _VELOCITY_COLUMNS, velocities)


def _write_rows(path: Path, columns: Sequence[str], rows: Sequence[Sequence[object]]) -> None:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(columns)
    writer.writerows(rows)
    path.write_text(text.getvalue(), encoding="utf-8")


def _read_settings(path: Path) -> dict[str, Any]:
    text = _read(path, 4096)
    try:
        if any(mark in text for mark in (b"&", b"*", b"!")):
            raise ValueError("aliases and tags are not allowed")
        found = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        raise PathFolderError(f"{path} is not YAML that can be read: {_reason(error)}") from error
    if not isinstance(found, dict):
        raise PathFolderError(f"{path} holds {quoted(found)}, must be a mapping with {', '.join(_KEYS)}")
    for key in found:
        if key not in _KEYS:
            raise PathFolderError(f"{path}: {quoted(key)} is unknown; known: {', '.join(_KEYS)}")
    for key in _KEYS:
        if key not in found:
            raise PathFolderError(f"{path}: {key} is missing; needed: {', '.join(_KEYS)}")
    version = found["format"]
    if type(version) is not int or version < 1:  # 1.0 and true equal 1
        raise PathFolderError(f"{path}: format is {quoted(version)}, must be {FORMAT}; record the path again")
    if version > FORMAT:
        raise PathFolderError(f"{path}: format is {version}, this version reads {FORMAT}; update gibson_path_following")
    if not isinstance(found["camera"], str) or found["camera"] not in IMAGES_OF:
        raise PathFolderError(f"{path}: camera is {quoted(found['camera'])}, must be one of {', '.join(IMAGES_OF)}")
    _check_settings(found, str(path))
    return found


def _check_settings(found: dict[str, Any], what: str) -> None:
    """Raises PathFolderError for a value of path.yaml, of a known camera, that is not allowed; ``what``: begin of the message."""
    widest = 179.0 if found["camera"] == "pinhole" else 360.0
    for key, least, most in (("hfov_deg", 1.0, widest), ("spacing_m", 0.001, 100.0)):
        value = found[key]
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
            raise PathFolderError(f"{what}: {key} is {quoted(value)}, must be a number from {least:g} to {most:g}")
    for key, least_count, most_count in (("nodes", 2, MAX_NODES), ("width", 8, MAX_SIDE), ("height", 8, MAX_SIDE)):
        value = found[key]
        if isinstance(value, bool) or not isinstance(value, int) or not least_count <= value <= most_count:
            raise PathFolderError(f"{what}: {key} is {quoted(value)}, must be a whole number from {least_count} to {most_count}")
    pixels = found["nodes"] * found["width"] * found["height"] * len(IMAGES_OF[found["camera"]])
    if pixels > MAX_PIXELS:
        raise PathFolderError(
            f"{what}: its images have {pixels / 1e6:.0f} megapixels, at most {MAX_PIXELS / 1e6:.0f} are read; record smaller ones"
        )


def _read_velocities(path: Path, nodes: int) -> list[list[tuple[int, Velocity]]]:
    found: list[list[tuple[int, Velocity]]] = [[] for _ in range(nodes)]
    for i, row in enumerate(_read_rows(path, _VELOCITY_COLUMNS, MAX_VELOCITIES)):
        where = f"{path}, line {i + 2}"
        node, after = _whole(where, "node", row[0]), _whole(where, "after_ns", row[1])
        if not 0 <= node < nodes:
            raise PathFolderError(f"{where}: node is {node}, must be 0 to {nodes - 1}")
        if after < 0 or (found[node] and after <= found[node][-1][0]):
            raise PathFolderError(f"{where}: after_ns is {after}, must be 0 or more and grow within a node")
        velocity = Velocity(_number(where, "linear_mps", row[2]), _number(where, "angular_radps", row[3]))
        found[node].append((after, velocity))
    return found


def _read_rows(path: Path, columns: Sequence[str], most: int) -> list[list[str]]:
    try:
        # Spreadsheets write a byte order mark, and editors a blank line at the end.
        text = _read(path, (most + 1) * _MAX_ROW_BYTES).decode("utf-8-sig").rstrip()
        rows = list(csv.reader(io.StringIO(text, newline="")))
    except (UnicodeDecodeError, csv.Error) as error:
        raise PathFolderError(f"{path} is not a CSV file in UTF-8: {_reason(error)}; record the path again") from error
    if not rows or rows[0] != list(columns):
        raise PathFolderError(f"{path}: its first line must be {','.join(columns)}")
    if len(rows) - 1 > most:
        raise PathFolderError(f"{path} has {len(rows) - 1} rows, at most {most} are read")
    for i, row in enumerate(rows[1:]):
        if len(row) != len(columns):
            raise PathFolderError(f"{path}, line {i + 2}: {len(row)} values, must be {len(columns)}: {','.join(columns)}")
    return rows[1:]


def _read_image(path: Path, size: tuple[int, int]) -> Image:
    data = _read(path, _MAX_IMAGE_BYTES)
    found = image_size(data) if data.startswith(b"\x89PNG") else None
    if found is None:
        raise PathFolderError(f"{path} is not a PNG image; record the path again")
    if found != size:
        raise PathFolderError(f"{path} has {found[0]}x{found[1]} pixels, but {SETTINGS_FILE} says {size[0]}x{size[1]}")
    try:
        image = cv2.imdecode(np.frombuffer(data, dtype=np.uint8), cv2.IMREAD_COLOR)
    except cv2.error:
        image = None
    if image is None:
        raise PathFolderError(f"{path} is a broken PNG image; record the path again")
    return cast("Image", np.ascontiguousarray(image[..., ::-1]))


def _read(path: Path, most: int) -> bytes:
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)  # a pipe must not block
        with open(descriptor, "rb") as file:
            if not stat.S_ISREG(os.fstat(descriptor).st_mode):
                raise PathFolderError(f"{path} is not a regular file")
            data = file.read(most + 1)
    except (OSError, ValueError) as error:
        hint = "; give a folder that was recorded" if path.name == SETTINGS_FILE else ""
        raise PathFolderError(f"cannot read {path}: {_reason(error)}{hint}") from error
    if len(data) > most:
        raise PathFolderError(f"{path} is too large: at most {most / 2**20:g} MB are read")
    return data


def _whole(where: str, key: str, text: str) -> int:
    try:
        value = int(text) if len(text) <= 20 else None
    except ValueError:
        value = None
    if value is None or abs(value) >= 2**63:
        raise PathFolderError(f"{where}: {key} is {quoted(text)}, must be a whole number")
    return value


def _number(where: str, key: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not abs(value) <= MAX_VALUE:
        raise PathFolderError(f"{where}: {key} is {quoted(text)}, must be a number of at most {MAX_VALUE:g}")
    return value


def _reason(error: Exception) -> str:
    reason = (error.strerror if isinstance(error, OSError) else None) or str(error) or type(error).__name__
    return " ".join(reason.split())[:200]
