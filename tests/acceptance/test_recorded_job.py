"""The main job end to end: drive, record, film, stop; then the bag, read by other software, must agree with the world."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from support.simulation import Launched, require

require("rclpy", "gibson_msgs")

import trimesh  # noqa: E402
from rosbags.highlevel import AnyReader  # noqa: E402
from rosbags.typesys import Stores, get_typestore  # noqa: E402

from gibson_sim.formats.load_mesh import MeshLoader  # noqa: E402
from gibson_sim.geometry.transforms import invert, matrix_from_quat, transform_points  # noqa: E402
from gibson_sim.scenes.load import load_scene  # noqa: E402

pytestmark = pytest.mark.ros
DURATION_S = 12
CAMERA_HZ = 5


@dataclass
class Job:
    scene: str
    folder: Path
    lines: list[str]
    code: int
    messages: dict[str, list[Any]]

    def stamps(self, topic: str) -> list[int]:
        return [_stamp(m) for m in self.messages[topic]]


def _stamp(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


WORLDS = {"flat": "flat", "aws": "aws_small_house", "living_room": "drake_living_room"}


@pytest.fixture(scope="module", params=WORLDS)
def job(request: pytest.FixtureRequest, ros_domain: int, tmp_path_factory: pytest.TempPathFactory) -> Job:
    scene = WORLDS[request.param]
    if scene != "flat":
        scene = str(request.getfixturevalue("data_dir") / scene)
    folder = tmp_path_factory.mktemp(request.param)
    launched = Launched(
        "run", "--scene", scene, "--drive", "tour", "--duration", str(DURATION_S), "--camera-rate", str(CAMERA_HZ),
        "--record", str(folder / "bag"), "--video", str(folder / "film.mp4"), "--summary", str(folder / "summary.json"),
    )  # fmt: skip
    code = launched.wait()
    messages: dict[str, list[Any]] = {}
    with AnyReader([folder / "bag"], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        for connection, _, data in reader.messages():
            messages.setdefault(connection.topic, []).append(reader.deserialize(data, connection.msgtype))
    return Job(scene, folder, launched.lines, code, messages)


def test_job_ends_by_itself_with_exit_code_zero(job: Job) -> None:
    assert job.code == 0, "\n".join(job.lines)


def test_first_image_is_recorded_when_time_begins(job: Job) -> None:
    first_ns = job.stamps("/camera/image_raw")[0]
    assert first_ns <= 2 * 10**9 // CAMERA_HZ, "time begins when the renderer can draw; a recorder does not delay it"


def test_video_and_contact_sheet_are_not_blank(job: Job) -> None:
    film = cv2.VideoCapture(str(job.folder / "film.mp4"))
    frames, fps = film.get(cv2.CAP_PROP_FRAME_COUNT), film.get(cv2.CAP_PROP_FPS)
    stamps = job.stamps("/camera/image_raw")
    span_s = (stamps[-1] - stamps[0]) * 1e-9
    assert (frames - 1) / fps == pytest.approx(span_s, abs=1 / fps), "as long as the drive: a skipped image is its neighbour"
    ok, picture = film.read()
    film.release()
    assert ok
    assert picture.std() > 5
    sheet = cv2.imread(str(job.folder / "film.png"))
    assert min(sheet.shape[:2]) > 200
    assert sheet.std() > 5


def test_every_image_has_the_stamp_of_an_odometry_and_of_its_camera_info(job: Job) -> None:
    odometry = set(job.stamps("/odom"))
    assert len(job.messages["/camera/image_raw"]) >= DURATION_S, "one a second, on the slowest machine"
    for image, info in (("image_raw", "camera_info"), ("depth/image_raw", "depth/camera_info")):
        stamps = job.stamps(f"/camera/{image}")
        assert set(stamps) <= odometry
        assert set(stamps) == set(job.stamps(f"/camera/{info}"))


def test_stamps_rise_on_every_topic(job: Job) -> None:
    for topic in (
        "/odom",
        "/ground_truth/odom",
        "/joint_states",
        "/scan",
        "/camera/image_raw",
        "/camera/depth/image_raw",
        "/scene_state",
    ):
        stamps = job.stamps(topic)
        assert all(a < b for a, b in pairwise(stamps)), topic


def test_robot_toured_and_its_odometry_is_within_two_per_cent_of_the_truth(job: Job) -> None:
    def path(topic: str) -> NDArray[np.float64]:
        return np.array([(m.pose.pose.position.x, m.pose.pose.position.y) for m in job.messages[topic]])

    truth, wheels = path("/ground_truth/odom"), path("/odom")
    driven = float(np.linalg.norm(np.diff(truth, axis=0), axis=1).sum())
    assert driven > 1.0
    by_wheels = float(np.linalg.norm(np.diff(wheels, axis=0), axis=1).sum())
    assert by_wheels == pytest.approx(driven, rel=0.02)
    # Where it ended, both from the start: 2 % of the way.
    first = job.messages["/ground_truth/odom"][0].pose.pose
    yaw = 2 * math.atan2(first.orientation.z, first.orientation.w)
    turn = np.array([[math.cos(yaw), -math.sin(yaw)], [math.sin(yaw), math.cos(yaw)]])
    ended = truth[0] + turn @ (wheels[-1] - wheels[0])
    assert np.linalg.norm(ended - truth[-1]) < 0.02 * driven + 0.01


def test_depth_lands_on_the_mesh_through_camera_info_and_tf(job: Job) -> None:
    """The whole chain map -> odom -> base -> ... -> optical frame, taken from /tf and /tf_static alone."""
    static = {t.child_frame_id: t for m in job.messages["/tf_static"] for t in m.transforms}
    moving = {(t.child_frame_id, _stamp(t)): t for m in job.messages["/tf"] for t in m.transforms}
    vertices, triangles = _visual_triangles(job.scene)
    depths, infos = job.messages["/camera/depth/image_raw"], job.messages["/camera/depth/camera_info"]
    errors = []
    for index in np.linspace(0, len(depths) - 1, 4).astype(int):
        message, info = depths[index], infos[index]
        frame, to_map = message.header.frame_id, np.eye(4)
        while frame != "map":
            link = static.get(frame) or moving[frame, _stamp(message)]
            to_map = _matrix(link.transform) @ to_map
            frame = link.header.frame_id
        depth = np.frombuffer(message.data, np.float32).reshape(message.height, message.width)
        rows, columns = np.mgrid[20 : message.height : 60, 20 : message.width : 60].reshape(2, -1)
        z = depth[rows, columns].astype(np.float64)
        seen = np.isfinite(z) & (z < 8.0)
        k = info.k
        points = np.column_stack([(columns - k[2]) / k[0] * z, (rows - k[5]) / k[4] * z, z])[seen]
        errors.append(_distances(vertices, triangles, transform_points(to_map, points)))
    assert sum(map(len, errors)) > 100
    assert np.median(np.concatenate(errors)) < 0.01


def _matrix(transform: Any) -> NDArray[np.float64]:
    t, r = transform.translation, transform.rotation
    matrix = np.eye(4)
    matrix[:3, :3] = matrix_from_quat((r.x, r.y, r.z, r.w))
    matrix[:3, 3] = (t.x, t.y, t.z)
    assert np.allclose(invert(matrix) @ matrix, np.eye(4))
    return matrix


def _visual_triangles(name: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Returns what is drawn of the scene, straight from its files: (V, 3) metres in the map frame, (F, 3)."""
    from gibson_sim.geometry.transforms import matrix_from_pose

    scene = load_scene(name)
    loader = MeshLoader((scene.root,), textures=False)
    vertices, triangles, count = [], [], 0
    for visual in scene.visuals:
        v, t = loader.shape(visual.shape).merged()
        vertices.append(transform_points(matrix_from_pose(visual.pose), v))
        triangles.append(np.asarray(t, dtype=np.int64) + count)
        count += len(v)
    return np.concatenate(vertices), np.concatenate(triangles)


def _distances(vertices: NDArray[np.float64], triangles: NDArray[np.int64], points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Returns the distance of each point to the nearest triangle, metres (triangles within 0.25 m; else 0.25)."""
    corners = vertices[triangles]
    low, high = corners.min(axis=1) - 0.25, corners.max(axis=1) + 0.25
    distances = np.full(len(points), 0.25)
    for i, point in enumerate(points):
        near = corners[((low <= point) & (point <= high)).all(axis=1)]
        if len(near):
            closest = trimesh.triangles.closest_point(near, np.repeat(point[None], len(near), axis=0))
            distances[i] = min(0.25, float(np.linalg.norm(closest - point, axis=1).min()))
    return distances


def test_summary_reports_what_was_measured(job: Job) -> None:
    summary = json.loads((job.folder / "summary.json").read_text())
    assert summary["physics"]["simulation_time_s"] == pytest.approx(DURATION_S, abs=0.02)
    images = summary["render"]["images"]["camera"]
    assert images == len(job.messages["/camera/image_raw"]), "every image that was drawn is in the bag"
    stamps = job.stamps("/camera/image_raw")
    due = round((stamps[-1] - stamps[0]) * 1e-9 * CAMERA_HZ) + 1
    counted = images + summary["render"]["skipped_images"]
    assert due <= counted <= CAMERA_HZ * DURATION_S, "every other since the first is counted; before that, nobody listened"
    assert summary["physics"]["refused_commands"] == 0
