"""nerfstudio's ``transforms.json``, see https://docs.nerf.studio/quickstart/data_conventions.html.

Its cameras look along -z with y up (OpenGL), and the centre of its first pixel is at (0.5, 0.5), ours at (0, 0). Depth is 16-bit PNG in
millimetres, as nerfstudio expects.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gibson_sim.bags.export.files import MM_PER_METRE, ImageFiles, image_suffix, seconds
from gibson_sim.bags.export.job import ExportJob
from gibson_sim.bags.export.read import ExportCamera, nearest
from gibson_sim.errors import RecordError
from gibson_sim.quoting import quoted
from gibson_sim.writing import write_file

OPENGL_FROM_OPTICAL: NDArray[np.float64] = np.diag([1.0, -1.0, -1.0, 1.0])
"""Rotation between the OpenGL frame (x right, y up, z back) and the optical frame (x right, y down, z forward); its own inverse."""
_PIXEL_CENTRE = 0.5
_MODELS = {"plumb_bob": "OPENCV", "": "OPENCV", "equidistant": "OPENCV_FISHEYE"}
_DISTORTIONS = {"OPENCV": ("k1", "k2", "p1", "p2", "k3"), "OPENCV_FISHEYE": ("k1", "k2", "k3", "k4")}


def export_nerfstudio(job: ExportJob) -> None:
    """Writes ``transforms.json`` and its images.

    Raises:
        RecordError: a camera has no calibration, one that the format does not support, or no poses; or cameras have different models.
    """
    cameras = [camera for camera in job.cameras if "rgb" in camera.streams]
    if not cameras:
        raise RecordError(
            f"bag {job.bag.folder} has no colour images, which nerfstudio needs: render some with `gibson-sim render`"
        )
    models = {camera.name: _model(camera) for camera in cameras}
    if len(set(models.values())) > 1:
        listed = ", ".join(f"{name} ({model})" for name, model in models.items())
        raise RecordError(f"a nerfstudio data set has one camera model, the bag has {listed}: choose some with --topics")
    model = models[cameras[0].name]
    files = _write_images(job, cameras, with_depth=model == "OPENCV")
    frames: list[dict[str, Any]] = []
    for camera in cameras:
        frames += _frames(job, camera, model, files[camera.name])
    if any("depth_file_path" in frame for frame in frames):
        complete = [frame for frame in frames if "depth_file_path" in frame]
        if len(complete) < len(frames):
            job.report.notes.append(
                f"{len(frames) - len(complete)} images without depth are left out: nerfstudio requires depth for all images or for none"
            )
        frames = complete
    if not frames:
        raise RecordError(f"no image of bag {job.bag.folder} has a pose: " + "; ".join(job.report.notes))
    document = {
        "camera_model": model,
        "applied_transform": np.eye(4)[:3].tolist(),
        "depth_unit_scale_factor": 1.0 / MM_PER_METRE,
        "frames": frames,
    }
    write_file(job.output / "transforms.json", json.dumps(document, indent=1) + "\n")
    job.report.lines.append(f"{job.output / 'transforms.json'}: {len(frames)} frames of {', '.join(models)}, model {model}")


def _model(camera: ExportCamera) -> str:
    """Returns nerfstudio's name for the camera's model."""
    lens = camera.lens
    if lens is None:
        raise RecordError(
            f"camera {camera.name} has no camera_info in the namespace of {camera.streams['rgb'].topic}: record it too"
        )
    model = _MODELS.get(lens.model)
    if model is None or not lens.is_projective or len(lens.d) > 5:
        raise RecordError(
            f"camera {camera.name} has the model {quoted(lens.model)} with {len(lens.d)} numbers, which nerfstudio does not support: render the run "
            "again with a pinhole camera (`gibson-sim render`), or export to png"
        )
    return model


def intrinsics(camera: ExportCamera, model: str) -> dict[str, float]:
    """Returns the intrinsics with nerfstudio's keys, pixels."""
    assert camera.lens is not None
    k = camera.lens.k
    values: dict[str, float] = {
        "fl_x": k[0], "fl_y": k[4], "cx": k[2] + _PIXEL_CENTRE, "cy": k[5] + _PIXEL_CENTRE, "w": camera.width, "h": camera.height,
    }  # fmt: skip
    values.update(dict(zip(_DISTORTIONS[model], camera.lens.d, strict=False)))
    return values


def _write_images(job: ExportJob, cameras: Sequence[ExportCamera], *, with_depth: bool) -> dict[str, dict[str, dict[int, str]]]:
    """Writes the images; returns their file names by camera, output and stamp."""
    files: dict[str, dict[str, dict[int, str]]] = {camera.name: {"rgb": {}, "depth": {}} for camera in cameras}
    if not with_depth and any("depth" in camera.streams for camera in cameras):
        job.report.notes.append(
            "depth is left out: depth of a fisheye is measured from its centre, nerfstudio's along the optical axis"
        )
    with ImageFiles(MM_PER_METRE) as writer:
        for picture in job.images(cameras):
            if picture.output != "rgb" and not (with_depth and picture.output == "depth"):
                continue
            folder = "images" if picture.output == "rgb" else "depths"
            suffix = image_suffix(picture, job.options.image, "png")
            name = f"{folder}/{picture.camera.name}_{seconds(picture.stamp_ns)}.{suffix}"
            files[picture.camera.name][picture.output][picture.stamp_ns] = name
            writer.write(job.output / name, picture)
    return files


def _frames(job: ExportJob, camera: ExportCamera, model: str, files: dict[str, dict[int, str]]) -> list[dict[str, Any]]:
    source = job.pose_source(camera)
    if source is None:
        return []
    frames, without_pose = [], 0
    depths = np.array(sorted(files["depth"]), dtype=np.int64)
    for stamp, name in sorted(files["rgb"].items()):
        T_world_optical = source.pose(camera, stamp)
        if T_world_optical is None:
            without_pose += 1
            continue
        frame: dict[str, Any] = {
            "file_path": name,
            "transform_matrix": (T_world_optical @ OPENGL_FROM_OPTICAL).tolist(),
            **intrinsics(camera, model),
        }
        if (depth_stamp := nearest(depths, stamp, job.most_ns)) is not None:
            frame["depth_file_path"] = files["depth"][depth_stamp]
        frames.append(frame)
    if without_pose:
        job.report.notes.append(
            f"camera {camera.name}: {without_pose} images are left out, since {source.text} has no pose for them"
        )
    return frames
