"""Reads and writes trajectories (Open3D's trajectory.log, TUM format) and associates stamps. Pure except for files."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from gibson_sim.geometry.interpolation import slerp
from gibson_sim.geometry.transforms import matrices_from_poses, quat_from_matrix
from gibson_sim.writing import write_file
from gibson_sim_tools.scanning.posed_images import ScanError, check_pose

F64 = NDArray[np.float64]
I64 = NDArray[np.int64]
_LINES_PER_FRAME = 5


def read_lines(path: Path) -> list[tuple[int, str]]:
    """Returns number and text of the lines of a text file that are neither empty nor comments (#).

    Raises:
        ScanError: it cannot be read, or is no text.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise ScanError(f"{path}: cannot be read: {error.strerror or error}") from error
    except UnicodeDecodeError as error:
        raise ScanError(f"{path}: is not a text file") from error
    lines = ((number, line.strip()) for number, line in enumerate(text.splitlines(), 1))
    return [(number, line) for number, line in lines if line and not line.startswith("#")]


def parse_numbers(path: Path, number: int, words: Sequence[str], count: int, what: str) -> list[float]:
    """Returns the ``count`` numbers of a line.

    Raises:
        ScanError: the line has other content; ``what`` describes what it must hold.
    """
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if len(values) != count:
        raise ScanError(f"{path}:{number}: {' '.join(words)[:80]!r} must be {what}")
    return values


def read_trajectory_log(path: Path) -> F64:
    """Returns T_world_camera of all frames, (N, 4, 4), from a file in Open3D's format: per frame, a line of three numbers and four rows.

    Raises:
        ScanError: the file is broken; the message names the line.
    """
    lines = read_lines(path)
    if len(lines) % _LINES_PER_FRAME:
        raise ScanError(
            f"{path}: has {len(lines)} lines, must have {_LINES_PER_FRAME} for each frame: three whole numbers, then a 4x4 matrix by rows"
        )
    poses = []
    for start in range(0, len(lines), _LINES_PER_FRAME):
        head, *rows = lines[start : start + _LINES_PER_FRAME]
        if len(head[1].split()) != 3:
            raise ScanError(f"{path}:{head[0]}: {head[1][:80]!r} must be the three whole numbers that begin a frame")
        pose = np.array([parse_numbers(path, n, line.split(), 4, "the four numbers of a row of a matrix") for n, line in rows])
        check_pose(f"{path}:{head[0]}: frame {start // _LINES_PER_FRAME}", pose)
        poses.append(pose)
    return np.array(poses).reshape(-1, 4, 4)


def write_trajectory_log(path: Path, poses: ArrayLike) -> None:
    """Writes T_world_camera, (N, 4, 4), in Open3D's format."""
    lines = []
    for number, pose in enumerate(np.asarray(poses, dtype=np.float64)):
        lines.append(f"{number} {number} {number + 1}")
        lines += [" ".join(f"{value:.10f}" for value in row) for row in pose]
    write_file(path, "\n".join(lines) + "\n")


def read_stamped_poses(path: Path) -> tuple[F64, F64]:
    """Returns stamps (N,), seconds, ascending, and T_world_camera (N, 4, 4), from rows ``stamp tx ty tz qx qy qz qw`` (TUM).

    Raises:
        ScanError: a line is broken, or two have the same stamp.
    """
    rows = [
        parse_numbers(path, n, line.replace(",", " ").split(), 8, "a stamp, a position and a quaternion: 8 numbers")
        for n, line in read_lines(path)
    ]
    table = np.array(rows, dtype=np.float64).reshape(-1, 8)
    if not np.isfinite(table).all():
        bad = int(np.flatnonzero(~np.isfinite(table).all(axis=1))[0])
        raise ScanError(f"{path}: row {bad} holds a NaN or an infinity; leave it out")
    table = table[np.argsort(table[:, 0], kind="stable")]
    if len(table) > 1 and (np.diff(table[:, 0]) <= 0.0).any():
        same = float(table[1:, 0][np.diff(table[:, 0]) <= 0.0][0])
        raise ScanError(f"{path}: two poses have the stamp {same:.6f} s; each may have one")
    length = np.linalg.norm(table[:, 4:], axis=1)
    if (np.abs(length - 1.0) > 1e-2).any():
        bad = int(np.argmax(np.abs(length - 1.0)))
        raise ScanError(
            f"{path}: the quaternion at stamp {table[bad, 0]:.6f} s has length {length[bad]:.3g}; it must be 1, as qx qy qz qw"
        )
    return table[:, 0], matrices_from_poses(table[:, 1:4], table[:, 4:] / length[:, None])


def write_stamped_poses(path: Path, stamps: ArrayLike, poses: ArrayLike) -> None:
    """Writes rows ``stamp tx ty tz qx qy qz qw``, seconds and metres, of T_world_camera (N, 4, 4)."""
    lines = ["# stamp_s tx ty tz qx qy qz qw: T_world_camera, optical frame"]
    for stamp, pose in zip(np.asarray(stamps, dtype=np.float64), np.asarray(poses, dtype=np.float64), strict=True):
        values = (*pose[:3, 3], *quat_from_matrix(pose[:3, :3]))
        lines.append(f"{stamp:.6f} " + " ".join(f"{value:.9f}" for value in values))
    write_file(path, "\n".join(lines) + "\n")


def associate(first: ArrayLike, second: ArrayLike, tolerance_s: float) -> I64:
    """Returns index pairs (N, 2) of two lists of stamps, seconds: matched by smallest difference, each stamp once, sorted by time."""
    a, b = np.asarray(first, dtype=np.float64), np.asarray(second, dtype=np.float64)
    order = np.argsort(b, kind="stable")
    candidates: list[tuple[float, int, int]] = []
    low, high = np.searchsorted(b[order], a - tolerance_s, "left"), np.searchsorted(b[order], a + tolerance_s, "right")
    for i in range(len(a)):
        candidates += [(abs(float(a[i] - b[j])), i, int(j)) for j in order[low[i] : high[i]]]
    matched_a, matched_b, pairs = set(), set(), []
    for _, i, j in sorted(candidates):
        if i not in matched_a and j not in matched_b:
            matched_a.add(i)
            matched_b.add(j)
            pairs.append((i, j))
    return np.array(sorted(pairs, key=lambda pair: a[pair[0]]), dtype=np.int64).reshape(-1, 2)


def pose_at(stamps: F64, poses: F64, stamp: float, tolerance_s: float) -> F64 | None:
    """Returns T_world_camera (4, 4) at a time, interpolated or nearest; None if no pose is near enough.

    Args:
        stamps: (N,), seconds, ascending.
        poses: (N, 4, 4).
        stamp: seconds.
        tolerance_s: limit for the nearest pose, seconds; the gap that is interpolated may be three times as long.
    """
    after = int(np.searchsorted(stamps, stamp))
    if 0 < after < len(stamps) and stamps[after] - stamps[after - 1] <= 3.0 * tolerance_s:
        part = float((stamp - stamps[after - 1]) / (stamps[after] - stamps[after - 1]))
        a, b = poses[after - 1], poses[after]
        quat = slerp(quat_from_matrix(a[:3, :3]), quat_from_matrix(b[:3, :3]), part)
        between: F64 = matrices_from_poses(((1.0 - part) * a[:3, 3] + part * b[:3, 3])[None], quat[None])[0]
        return between
    near = [i for i in (after - 1, after) if 0 <= i < len(stamps)]
    best = min(near, key=lambda i: abs(float(stamps[i]) - stamp), default=-1)
    if best < 0 or not math.isclose(float(stamps[best]), stamp, rel_tol=0.0, abs_tol=tolerance_s):
        return None
    return np.asarray(poses[best])
