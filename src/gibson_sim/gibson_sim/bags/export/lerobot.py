"""LeRobot's data set format, version 3.0: one bag becomes one episode.

Tables are Parquet (the extra ``lerobot`` installs pyarrow), colour images one H.264 video per camera. Frames are evenly spaced: each has
the newest image, observation and command at its time. https://huggingface.co/docs/lerobot/lerobot-dataset-v3
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.export.job import ExportJob
from gibson_sim.bags.export.read import ExportCamera
from gibson_sim.bags.stamps import nominal_period_ns, time_from_msg
from gibson_sim.bags.video_file import write_frames
from gibson_sim.errors import EnvironmentProblemError, RecordError
from gibson_sim.geometry.transforms import yaw_from_quat
from gibson_sim.types import NS_PER_S
from gibson_sim.writing import replacing, write_file

VERSION = "v3.0"
_ODOMETRY, _JOINTS = "nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState"
_TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")
_ODOMETRY_NAMES = ("x", "y", "yaw", "vx", "vy", "wz")
_ACTION_NAMES = ("vx", "vy", "wz")
_TRUTH = "ground_truth"
_FILE = "chunk-000/file-000"
_QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
_VIDEO_OPTIONS = {"crf": "20", "preset": "veryfast", "g": "2", "bf": "0"}
"""Options of libx264; every second frame is a key frame, for random access."""
_IMAGES_MEASURED = 100
"""Maximum number of images from which the statistics of a camera are computed."""
_DEFAULTS: dict[str, dict[str, Any]] = {
    "timestamp": {"dtype": "float32", "shape": [1], "names": None},
    "frame_index": {"dtype": "int64", "shape": [1], "names": None},
    "episode_index": {"dtype": "int64", "shape": [1], "names": None},
    "index": {"dtype": "int64", "shape": [1], "names": None},
    "task_index": {"dtype": "int64", "shape": [1], "names": None},
}
"""Columns of every data set."""


@dataclass(frozen=True, slots=True, eq=False)
class _Series:
    """Measurements over time, each held until the next."""

    names: tuple[str, ...]
    stamps: NDArray[np.int64]
    rows: NDArray[np.float64]

    def at(self, stamps: NDArray[np.int64]) -> NDArray[np.float32]:
        """Returns the newest row at each time, (N, columns); zeros before the first."""
        newest = np.searchsorted(self.stamps, stamps, side="right") - 1
        values = self.rows[np.maximum(newest, 0)]
        values[newest < 0] = 0.0
        return values.astype(np.float32)


def export_lerobot(job: ExportJob) -> None:
    """Writes ``meta/``, ``data/`` and ``videos/``.

    Raises:
        EnvironmentProblemError: pyarrow is not installed.
        RecordError: there are no colour images.
    """
    if find_spec("pyarrow") is None:
        raise EnvironmentProblemError(
            "LeRobot data sets need pyarrow: pip install pyarrow, or install gibson_sim with its extra [lerobot]"
        )
    cameras = [camera for camera in job.cameras if "rgb" in camera.streams]
    if not cameras:
        raise RecordError(f"bag {job.bag.folder} has no colour images: render some with `gibson-sim render`")
    fps = job.options.fps or max(1, round(NS_PER_S / (nominal_period_ns(cameras[0].stamps["rgb"]) or NS_PER_S)))
    first = max(int(camera.stamps["rgb"][0]) for camera in cameras)
    last = min(int(camera.stamps["rgb"][-1]) for camera in cameras)
    count = int((last - first) * fps // NS_PER_S) + 1
    times = first + (np.arange(count, dtype=np.int64) * NS_PER_S + fps // 2) // fps
    state, action = _state(job), _action(job)
    numbers = {"observation.state": state.at(times), "action": action.at(times)}
    features: dict[str, dict[str, Any]] = {
        key: {"dtype": "float32", "shape": [len(series.names)], "names": list(series.names)}
        for key, series in (("observation.state", state), ("action", action))
    }
    stats = {key: _statistics(values.astype(np.float64)) for key, values in numbers.items()}
    for camera, (key, feature, measured) in zip(cameras, _videos(job, cameras, times, fps), strict=True):
        features[key], stats[key] = feature, measured
        max_age = int(np.max(times - camera.stamps["rgb"][np.searchsorted(camera.stamps["rgb"], times, side="right") - 1]))
        if max_age > 1.5 * NS_PER_S / fps:
            job.report.notes.append(f"camera {camera.name} has gaps: an image stands for up to {max_age / NS_PER_S:.2f} s")
    columns: dict[str, NDArray[Any]] = {
        "timestamp": (np.arange(count) / fps).astype(np.float32),
        "frame_index": np.arange(count),
        "episode_index": np.zeros(count, np.int64),
        "index": np.arange(count),
        "task_index": np.zeros(count, np.int64),
    }
    stats.update({key: _statistics(values.astype(np.float64)[:, None]) for key, values in columns.items()})
    _write_data(job.output, numbers, columns)
    _write_meta(job, {**features, **_DEFAULTS}, stats, count, fps)
    job.report.lines.append(f"{job.output}: LeRobot {VERSION}, one episode, {count} frames at {fps} Hz, {', '.join(features)}")


def _state(job: ExportJob) -> _Series:
    """Returns odometry and joint positions, whichever the bag has."""
    topics = job.bag.topics()
    odometry = [t for t, i in topics.items() if i.type_name == _ODOMETRY and i.count]
    odometry.sort(key=lambda topic: (_TRUTH in topic, topic))  # measured odometry before ground truth
    joints = [t for t, i in topics.items() if i.type_name == _JOINTS and i.count and not t.endswith("joint_command")]
    parts = [_read(job, topic, _ODOMETRY_NAMES, _odometry_row) for topic in odometry[:1]]
    if not parts:
        job.report.notes.append("no nav_msgs/Odometry: observation.state only has joints")
    if joints:
        msg = job.bag.first(joints[0])
        names = tuple(msg.name)
        parts.append(_read(job, joints[0], names, lambda msg: _joint_row(msg, names)))
    if not parts:
        raise RecordError(f"bag {job.bag.folder} has neither odometry nor joint states, which observation.state consists of")
    stamps = np.unique(np.concatenate([part.stamps for part in parts]))
    return _Series(
        tuple(name for part in parts for name in part.names),
        stamps,
        np.hstack([part.at(stamps) for part in parts]).astype(np.float64),
    )


def _action(job: ExportJob) -> _Series:
    """Returns the velocity commands, each held until the next."""
    topics = [t for t, i in job.bag.topics().items() if i.type_name in _TWISTS and i.count]
    topics.sort(key=lambda topic: (not topic.endswith("cmd_vel"), not topic.endswith("cmd_vel_applied"), topic))
    if not topics:
        job.report.notes.append("no commands (geometry_msgs/Twist or TwistStamped): action is zero")
        return _Series(_ACTION_NAMES, np.zeros(1, np.int64), np.zeros((1, 3)))
    return _read(job, topics[0], _ACTION_NAMES, _twist_row)


def _read(job: ExportJob, topic: str, names: tuple[str, ...], row: Any) -> _Series:
    """Returns the messages of a topic as rows, including those before the first image."""
    stamped = job.bag.topics()[topic].stamped
    stamps, rows = [], []
    for _, log_ns, msg in job.bag.messages([topic], stop_ns=job.end_ns + 1):
        stamps.append(time_from_msg(msg.header.stamp) if stamped else log_ns)
        rows.append(row(msg))
    order = np.argsort(stamps, kind="stable")
    return _Series(
        names, np.array(stamps, dtype=np.int64)[order], np.array(rows, dtype=np.float64).reshape(len(stamps), -1)[order]
    )


def _odometry_row(msg: Any) -> Sequence[float]:
    p, q, twist = msg.pose.pose.position, msg.pose.pose.orientation, msg.twist.twist
    return (p.x, p.y, yaw_from_quat((q.x, q.y, q.z, q.w)), twist.linear.x, twist.linear.y, twist.angular.z)


def _joint_row(msg: Any, names: Sequence[str]) -> Sequence[float]:
    positions = dict(zip(msg.name, msg.position, strict=False))
    return [float(positions.get(name, 0.0)) for name in names]


def _twist_row(msg: Any) -> Sequence[float]:
    twist = getattr(msg, "twist", msg)
    return (twist.linear.x, twist.linear.y, twist.angular.z)


def _videos(
    job: ExportJob, cameras: Sequence[ExportCamera], times: NDArray[np.int64], fps: int
) -> Iterator[tuple[str, dict[str, Any], dict[str, Any]]]:
    """Writes a video of each camera; yields its key, its feature and its statistics."""
    for camera in cameras:
        key = f"observation.images.{camera.name}"
        path = job.output / "videos" / key / f"{_FILE}.mp4"
        measured = _write_video(job, camera, times, fps, path)
        width, height = _even_size(camera)
        info = {
            "video.height": height, "video.width": width, "video.codec": "h264", "video.pix_fmt": "yuv420p",
            "video.fps": fps, "video.channels": 3, "has_audio": False, "is_depth_map": False,
        }  # fmt: skip
        yield (
            key,
            {"dtype": "video", "shape": [height, width, 3], "names": ["height", "width", "channels"], "info": info},
            measured,
        )


def _write_video(job: ExportJob, camera: ExportCamera, times: NDArray[np.int64], fps: int, path: Path) -> dict[str, Any]:
    """Writes the frames of a camera, each the newest image at its time; returns the statistics of the colours."""
    alone = ExportCamera(
        camera.name, camera.path, camera.frame_id, camera.width, camera.height, {"rgb": camera.streams["rgb"]}, camera.lens,
        {"rgb": camera.stamps["rgb"]},
    )  # fmt: skip
    every = max(1, len(times) // _IMAGES_MEASURED)
    samples: list[NDArray[np.uint8]] = []
    width, height = _even_size(camera)

    def frames() -> Iterator[tuple[int, NDArray[np.uint8]]]:
        for number, image in enumerate(_held(job, alone, times)):
            rgb = image[:height, :width]
            if number % every == 0:
                samples.append(rgb[::4, ::4])
            yield 1, rgb

    write_frames(path, fps, frames(), options=_VIDEO_OPTIONS, channels="rgb24")
    values = np.concatenate([sample.reshape(-1, 3) for sample in samples]).astype(np.float64) / 255.0
    statistics = _statistics(values)
    return {
        name: [len(samples)] if name == "count" else np.asarray(value).reshape(3, 1, 1).tolist()
        for name, value in statistics.items()
    }


def _even_size(camera: ExportCamera) -> tuple[int, int]:
    """Returns (width, height) of the video: 4:2:0 has one chroma sample for 2x2 pixels, so an odd last column or row is cropped."""
    return camera.width // 2 * 2, camera.height // 2 * 2


def _held(job: ExportJob, camera: ExportCamera, times: NDArray[np.int64]) -> Iterator[NDArray[np.uint8]]:
    """Yields the newest image at each time."""
    newest: NDArray[np.uint8] | None = None
    waiting = times.tolist()
    for picture in job.images([camera]):
        while waiting and newest is not None and picture.stamp_ns > waiting[0]:
            yield newest
            waiting.pop(0)
        newest = np.ascontiguousarray(picture.bgr()[:, :, ::-1])
    for _ in waiting:
        assert newest is not None
        yield newest


def _statistics(values: NDArray[np.float64]) -> dict[str, list[Any]]:
    """Returns minimum, maximum, mean, standard deviation, quantiles and count of each column of (N, C)."""
    statistics: dict[str, list[Any]] = {
        "min": values.min(axis=0).tolist(), "max": values.max(axis=0).tolist(), "mean": values.mean(axis=0).tolist(),
        "std": values.std(axis=0).tolist(), "count": [len(values)],
    }  # fmt: skip
    statistics.update({name: np.quantile(values, part, axis=0).tolist() for name, part in _QUANTILES.items()})
    return statistics


def _write_data(folder: Path, numbers: dict[str, NDArray[np.float32]], columns: dict[str, NDArray[Any]]) -> None:
    import pyarrow as pa

    arrays: dict[str, Any] = {
        key: pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1]) for key, values in numbers.items()
    }
    arrays.update({key: pa.array(values) for key, values in columns.items()})
    _write_table(folder / "data" / f"{_FILE}.parquet", pa.table(arrays))


def _write_meta(job: ExportJob, features: dict[str, dict[str, Any]], stats: dict[str, Any], count: int, fps: int) -> None:
    import pyarrow as pa

    meta = job.output / "meta"
    videos = [key for key, feature in features.items() if feature["dtype"] == "video"]
    info = {
        "codebase_version": VERSION, "robot_type": None, "total_episodes": 1, "total_frames": count, "total_tasks": 1,
        "chunks_size": 1000, "data_files_size_in_mb": 100, "video_files_size_in_mb": 200, "fps": fps, "splits": {"train": "0:1"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4", "features": features,
    }  # fmt: skip
    write_file(meta / "info.json", json.dumps(info, indent=4) + "\n")
    write_file(meta / "stats.json", json.dumps(stats, indent=4) + "\n")
    episode: dict[str, Any] = {
        "episode_index": 0, "tasks": [job.options.task], "length": count, "data/chunk_index": 0, "data/file_index": 0,
        "dataset_from_index": 0, "dataset_to_index": count, "meta/episodes/chunk_index": 0, "meta/episodes/file_index": 0,
    }  # fmt: skip
    for key in videos:
        episode |= {
            f"videos/{key}/chunk_index": 0, f"videos/{key}/file_index": 0, f"videos/{key}/from_timestamp": 0.0,
            f"videos/{key}/to_timestamp": count / fps,
        }  # fmt: skip
    episode |= {f"stats/{key}/{name}": value for key, values in stats.items() for name, value in values.items()}
    _write_table(meta / "episodes" / f"{_FILE}.parquet", pa.table({name: [value] for name, value in episode.items()}))
    tasks = pa.table({"task_index": pa.array([0], pa.int64()), "task": [job.options.task]})
    _write_table(meta / "tasks.parquet", tasks.replace_schema_metadata({b"pandas": _pandas_index()}))


def _write_table(path: Path, table: Any) -> None:
    from pyarrow import parquet

    with replacing(path) as draft:
        parquet.write_table(table, draft)


def _pandas_index() -> bytes:
    """Returns the metadata that makes the column ``task`` the index in pandas, as LeRobot requires."""
    column = {"field_name": "task_index", "metadata": None, "name": "task_index", "numpy_type": "int64", "pandas_type": "int64"}
    index = {"field_name": "task", "metadata": None, "name": "task", "numpy_type": "object", "pandas_type": "unicode"}
    return json.dumps(
        {"index_columns": ["task"], "column_indexes": [], "columns": [column, index], "pandas_version": "2.0.0"}
    ).encode()
