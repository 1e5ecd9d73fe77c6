"""Plain files: images, a table for each camera with one row per image, and tables of other measurements."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from gibson_sim.bags.export.files import ImageFiles, image_suffix, seconds, write_table
from gibson_sim.bags.export.job import ExportJob
from gibson_sim.bags.export.read import ExportCamera, nearest
from gibson_sim.bags.stamps import time_from_msg
from gibson_sim.geometry.transforms import pose_from_matrix
from gibson_sim.writing import write_file

_POSE = ("x", "y", "z", "qx", "qy", "qz", "qw")
_TWIST = ("vx", "vy", "vz", "wx", "wy", "wz")


def export_png(job: ExportJob) -> None:
    """Writes ``<camera>/frames.csv``, ``<camera>/<output>/<stamp>.png``, and ``<topic>.csv`` for odometry, commands and IMUs."""
    files: dict[str, dict[str, dict[int, str]]] = {c.name: {output: {} for output in c.streams} for c in job.cameras}
    with ImageFiles() as writer:
        for picture in job.images(job.cameras):
            suffix = image_suffix(picture, job.options.image, job.options.depth)
            name = f"{picture.output}/{seconds(picture.stamp_ns)}.{suffix}"
            files[picture.camera.name][picture.output][picture.stamp_ns] = name
            writer.write(job.output / picture.camera.name / name, picture)
    for camera in job.cameras:
        _write_frames(job, camera, files[camera.name])
    write_series(job)


def _write_frames(job: ExportJob, camera: ExportCamera, files: dict[str, dict[int, str]]) -> None:
    source = job.pose_source(camera)
    stamps = {output: np.array(sorted(names), dtype=np.int64) for output, names in files.items()}

    def rows() -> Iterator[Sequence[Any]]:
        for stamp in sorted(files[camera.first]):
            T = source.pose(camera, stamp) if source is not None else None
            pose = [""] * len(_POSE)
            if T is not None:
                position_and_quat = pose_from_matrix(T)
                pose = [repr(value) for value in (*position_and_quat.position, *position_and_quat.quat_xyzw)]
            names = [files[output].get(nearest(stamps[output], stamp, job.most_ns) or -1, "") for output in files]
            yield (stamp, seconds(stamp), *pose, *names)

    folder = job.output / camera.name
    count = write_table(folder / "frames.csv", ("stamp_ns", "stamp", *_POSE, *files), rows())
    lens = camera.lens
    values = {
        "frame_id": camera.frame_id, "width": camera.width, "height": camera.height, "poses": source.text if source else "",
        "distortion_model": lens.model if lens else "", "k": lens.k if lens else (), "d": lens.d if lens else (),
        "depth_units_per_metre": 1000 if job.options.depth == "png" else 1,
    }  # fmt: skip
    write_file(folder / "camera.json", json.dumps(values, indent=1) + "\n")
    job.report.lines.append(f"{folder}: {count} images with {', '.join(files)}")


def _odometry(msg: Any) -> Sequence[float]:
    p, q, v, w = msg.pose.pose.position, msg.pose.pose.orientation, msg.twist.twist.linear, msg.twist.twist.angular
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w, v.x, v.y, v.z, w.x, w.y, w.z)


def _twist(msg: Any) -> Sequence[float]:
    twist = getattr(msg, "twist", msg)
    return (twist.linear.x, twist.linear.y, twist.linear.z, twist.angular.x, twist.angular.y, twist.angular.z)


def _imu(msg: Any) -> Sequence[float]:
    q, w, a = msg.orientation, msg.angular_velocity, msg.linear_acceleration
    return (q.x, q.y, q.z, q.w, w.x, w.y, w.z, a.x, a.y, a.z)


_SERIES: dict[str, tuple[tuple[str, ...], Callable[[Any], Sequence[float]]]] = {
    "nav_msgs/msg/Odometry": ((*_POSE, *_TWIST), _odometry),
    "geometry_msgs/msg/Twist": (_TWIST, _twist),
    "geometry_msgs/msg/TwistStamped": (_TWIST, _twist),
    "sensor_msgs/msg/Imu": ((*_POSE[3:], *_TWIST[3:], "ax", "ay", "az"), _imu),
}
"""Message type -> columns, and the function that returns their values."""


def write_series(job: ExportJob) -> None:
    """Writes a table for each topic of odometry, commands and IMUs. A message without a stamp gets its log time."""
    for topic, info in job.bag.topics().items():
        if info.type_name not in _SERIES or not info.count:
            continue
        columns, values = _SERIES[info.type_name]

        def rows(
            topic: str = topic, stamped: bool = info.stamped, values: Callable[[Any], Sequence[float]] = values
        ) -> Iterator[Sequence[Any]]:
            for _, log_ns, msg in job.bag.messages([topic], start_ns=job.begin_ns, stop_ns=job.end_ns + 1):
                stamp = time_from_msg(msg.header.stamp) if stamped else log_ns
                yield (stamp, *map(repr, map(float, values(msg))))

        path = job.output / f"{topic.strip('/').replace('/', '_')}.csv"
        count = write_table(path, ("stamp_ns", *columns), rows())
        job.report.lines.append(f"{path}: {count} rows of {topic}")
