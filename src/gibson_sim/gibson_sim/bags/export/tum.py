"""The TUM RGB-D format: lists of images with their times, and a trajectory.

``rgb.txt``, ``depth.txt`` (time, file), ``associations.txt`` (both, matched), ``groundtruth.txt`` (time tx ty tz qx qy qz qw of the optical
frame in the world). Depth images are 16-bit PNG with 5000 units per metre, as the format prescribes.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import yaml

from gibson_sim.bags.export.files import ImageFiles, image_suffix, seconds, write_lines
from gibson_sim.bags.export.job import ExportJob
from gibson_sim.bags.export.read import ExportCamera, nearest
from gibson_sim.geometry.transforms import Mat4, pose_from_matrix
from gibson_sim.writing import write_file

DEPTH_PER_METRE = 5000.0


def export_tum(job: ExportJob) -> None:
    """Writes one sequence per camera, each in a separate folder if there are several."""
    cameras = [camera for camera in job.cameras if {"rgb", "depth"} & set(camera.streams)]
    for camera in cameras:
        folder = job.output / camera.name if len(cameras) > 1 else job.output
        _sequence(job, camera, folder)


def _sequence(job: ExportJob, camera: ExportCamera, folder: Path) -> None:
    files: dict[str, dict[int, str]] = {"rgb": {}, "depth": {}}
    chosen = _only(camera, ("rgb", "depth"))
    with ImageFiles(DEPTH_PER_METRE) as writer:
        for picture in job.images([chosen]):
            name = f"{picture.output}/{seconds(picture.stamp_ns)}.{image_suffix(picture, job.options.image, job.options.depth)}"
            files[picture.output][picture.stamp_ns] = name
            writer.write(folder / name, picture)
    for output, names in files.items():
        if output in chosen.streams:
            lines = (f"{seconds(stamp)} {name}" for stamp, name in sorted(names.items()))
            write_lines(folder / f"{output}.txt", ("# timestamp filename", *lines))
    if len(chosen.streams) == 2:
        write_lines(folder / "associations.txt", _associations(files, job.most_ns))
    stamps = sorted({*files["rgb"], *files["depth"]})
    poses = _trajectory(job, camera, stamps)
    if poses is not None:
        write_lines(folder / "groundtruth.txt", ("# timestamp tx ty tz qx qy qz qw", *poses))
    _write_lens(camera, folder)
    counts = ", ".join(f"{len(files[output])} {output}" for output in chosen.streams)
    job.report.lines.append(f"{folder}: {counts}, {len(poses or ())} poses")


def _only(camera: ExportCamera, outputs: Sequence[str]) -> ExportCamera:
    """Returns the camera with only these outputs."""
    streams = {output: camera.streams[output] for output in outputs if output in camera.streams}
    return ExportCamera(
        camera.name, camera.path, camera.frame_id, camera.width, camera.height, streams, camera.lens, camera.stamps
    )  # fmt: skip


def _associations(files: dict[str, dict[int, str]], most_ns: int) -> list[str]:
    depths = np.array(sorted(files["depth"]), dtype=np.int64)
    lines = []
    for stamp, name in sorted(files["rgb"].items()):
        depth_stamp = nearest(depths, stamp, most_ns)
        if depth_stamp is not None:
            lines.append(f"{seconds(stamp)} {name} {seconds(depth_stamp)} {files['depth'][depth_stamp]}")
    return lines


def _trajectory(job: ExportJob, camera: ExportCamera, stamps: Sequence[int]) -> list[str] | None:
    source = job.pose_source(camera)
    if source is None:
        return None
    lines = [f"{seconds(stamp)} {pose_text(T)}" for stamp in stamps if (T := source.pose(camera, stamp)) is not None]
    if len(lines) < len(stamps):
        job.report.notes.append(
            f"camera {camera.name}: {len(stamps) - len(lines)} of {len(stamps)} images have no pose in {source.text}"
        )
    return lines


def pose_text(matrix: Mat4) -> str:
    """Returns ``tx ty tz qx qy qz qw`` of T_world_camera."""
    pose = pose_from_matrix(matrix)
    return " ".join(f"{value:.9f}" for value in (*pose.position, *pose.quat_xyzw))


def _write_lens(camera: ExportCamera, folder: Path) -> None:
    """Writes the calibration and the depth scale, for which the format has no file."""
    lens = camera.lens
    values = {
        "width": camera.width, "height": camera.height, "frame_id": camera.frame_id, "depth_units_per_metre": DEPTH_PER_METRE,
        "distortion_model": lens.model if lens else "", "k": list(lens.k) if lens else [], "d": list(lens.d) if lens else [],
    }  # fmt: skip
    write_file(folder / "camera.yaml", yaml.safe_dump(values, sort_keys=False, default_flow_style=None))
