"""Data sets from synthetic bags: a wall seen from two places, so that every depth has a closed form."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import av
import cv2
import numpy as np
import pytest
import yaml
from numpy.typing import NDArray

from gibson_sim.bags.export import export_bag
from gibson_sim.bags.export.job import ExportOptions
from gibson_sim.bags.export.read import CameraImage, depth_in_units
from gibson_sim.bags.images.decode import COMPRESSED
from gibson_sim.bags.writer import BagWriter, TopicQos
from gibson_sim.errors import EnvironmentProblemError, RecordError
from gibson_sim.geometry.transforms import (
    R_LINK_OPTICAL,
    Mat4,
    matrix_from_pose,
    matrix_from_quat,
    pose_from_matrix,
    pose_from_xyz_rpy,
    transform_points,
)
from support.exif import jpeg_with_orientation

MS = 1_000_000
STAMPS = (100 * MS, 133_333_333, 200 * MS)
WIDTH, HEIGHT, FOCAL = 40, 30, 50.0
CX, CY = 18.0, 15.5
WALL_X = 3.0
MOUNT = matrix_from_pose(pose_from_xyz_rpy((0.1, 0.02, 0.3), (0.0, 0.1, -0.2)))
MOUNT[:3, :3] = MOUNT[:3, :3] @ R_LINK_OPTICAL
"""T_link_optical."""


def _link(stamp_ns: int) -> Mat4:
    """Returns T_world_link of a robot that drives forward and turns."""
    t = stamp_ns * 1e-9
    return matrix_from_pose(pose_from_xyz_rpy((2.0 * t, -t, 0.05), (0.0, 0.0, 0.3 + 4.0 * t)))


def _depth(stamp_ns: int) -> NDArray[np.float32]:
    """Returns metres along the axis to the wall x = 3."""
    T = _link(stamp_ns) @ MOUNT
    v, u = np.mgrid[0:HEIGHT, 0:WIDTH]
    rays = np.stack([(u - CX) / FOCAL, (v - CY) / FOCAL, np.ones_like(u, dtype=float)], axis=-1) @ T[:3, :3].T
    return ((WALL_X - T[0, 3]) / rays[..., 0]).astype(np.float32)


def _unprojected(depth: NDArray[Any], T_world_camera: Mat4, cx: float, cy: float, centre: float) -> NDArray[np.float64]:
    v, u = np.mgrid[0 : depth.shape[0], 0 : depth.shape[1]] + centre
    points = np.stack([(u - cx) / FOCAL * depth, (v - cy) / FOCAL * depth, depth], axis=-1).reshape(-1, 3)
    return transform_points(T_world_camera, points)


class Drives:
    """Writes bags of a short drive."""

    def __init__(self, messages: Any, folder: Path) -> None:
        self.messages, self.folder, self.types, self.filled = messages, folder, messages.types, messages.filled

    def pose(self, T: Mat4) -> Any:
        pose = pose_from_matrix(T)
        return self.filled(
            "geometry_msgs/msg/Pose",
            position=self.types["geometry_msgs/msg/Point"](*pose.position),
            orientation=self.types["geometry_msgs/msg/Quaternion"](*pose.quat_xyzw),
        )

    def transform(self, ns: int, parent: str, child: str, T: Mat4) -> bytes:
        pose = self.pose(T)
        return self.messages.cdr(
            self.filled(
                "tf2_msgs/msg/TFMessage",
                transforms=[
                    self.filled(
                        "geometry_msgs/msg/TransformStamped",
                        header=self.messages.header(ns, parent),
                        child_frame_id=child,
                        transform=self.filled(
                            "geometry_msgs/msg/Transform",
                            translation=self.types["geometry_msgs/msg/Vector3"](
                                pose.position.x, pose.position.y, pose.position.z
                            ),
                            rotation=pose.orientation,
                        ),
                    )
                ],
            )
        )

    def info(self, ns: int, model: str, d: int) -> bytes:
        k = np.array([FOCAL, 0, CX, 0, FOCAL, CY, 0, 0, 1])
        return self.messages.cdr(
            self.filled(
                "sensor_msgs/msg/CameraInfo", header=self.messages.header(ns, "camera_optical_frame"),
                width=WIDTH, height=HEIGHT, distortion_model=model, k=k, d=np.zeros(d),
            )
        )  # fmt: skip

    def image(self, ns: int, pixels: NDArray[Any], encoding: str) -> bytes:
        return bytes(self.messages.image(ns, pixels, encoding))

    def scene(self) -> bytes:
        camera = self.filled(
            "gibson_msgs/msg/Camera", name="camera", link=1, pose=self.pose(MOUNT), frame_id="camera_optical_frame",
            outputs=["rgb", "depth"], width=WIDTH, height=HEIGHT,
        )  # fmt: skip
        scene = self.filled("gibson_msgs/msg/Scene", revision=1, links=["robot/base", "robot/head"], cameras=[camera])
        return bytes(self.messages.cdr(scene))

    def state(self, ns: int) -> bytes:
        pose = pose_from_matrix(_link(ns))
        return bytes(
            self.messages.cdr(
                self.filled(
                    "gibson_msgs/msg/SceneState", header=self.messages.header(ns, "map"), revision=1,
                    poses=np.array([*np.zeros(6), 1.0, *pose.position, *pose.quat_xyzw]), due_cameras=np.array([0], np.uint32),
                )
            )
        )  # fmt: skip

    def twist(self, vx: float) -> bytes:
        linear = self.types["geometry_msgs/msg/Vector3"](vx, 0.0, 0.0)
        return bytes(self.messages.cdr(self.filled("geometry_msgs/msg/Twist", linear=linear)))

    def write(
        self, *, states: bool = True, tf: bool = False, model: str = "plumb_bob", d: int = 5, commands: bool = True
    ) -> Path:
        """Writes colour (grey 50, 100, 150) and depth images, and the camera's poses."""
        topics = {
            "/camera/image_raw": "sensor_msgs/msg/Image",
            "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
            "/camera/depth/image_raw": "sensor_msgs/msg/Image",
        }
        if states:
            topics |= {"/scene": "gibson_msgs/msg/Scene", "/scene_state": "gibson_msgs/msg/SceneState"}
        if tf:
            topics |= {"/tf": "tf2_msgs/msg/TFMessage", "/tf_static": "tf2_msgs/msg/TFMessage"}
        if commands:
            topics |= {"/cmd_vel": "geometry_msgs/msg/Twist", "/odom": "nav_msgs/msg/Odometry"}
        with BagWriter(self.folder / "bag", reserve_bytes=0) as bag:
            for topic, type_name in topics.items():
                bag.add_topic(topic, type_name, TopicQos.latched() if topic in ("/scene", "/tf_static") else None)

            def write(topic: str, data: bytes, now: int) -> None:
                if topic in topics:
                    bag.write(topic, data, now, now)

            write("/scene", self.scene() if states else b"", STAMPS[0])
            write("/tf_static", self.transform(0, "base", "camera_optical_frame", MOUNT), STAMPS[0])
            for number, stamp in enumerate(STAMPS, 1):
                write("/scene_state", self.state(stamp) if states else b"", stamp)
                # Transforms are between the images: poses must be interpolated, and one more follows the last image.
                write("/tf", self.transform(stamp - 10 * MS, "map", "base", _link(stamp - 10 * MS)), stamp)
                write("/odom", self.messages.odometry(stamp, 0.1 * number, 0.0, 0.5), stamp)
                write("/camera/camera_info", self.info(stamp, model, d), stamp)
                write("/camera/image_raw", self.image(stamp, np.full((HEIGHT, WIDTH, 3), 50 * number, np.uint8), "rgb8"), stamp)
                write("/camera/depth/image_raw", self.image(stamp, _depth(stamp), "32FC1"), stamp)
                write("/cmd_vel", self.twist(float(number)), stamp + MS)
            last = STAMPS[-1] + 10 * MS
            write("/tf", self.transform(last, "map", "base", _link(last)), last)
        return self.folder / "bag"


@pytest.fixture
def drives(messages: Any, tmp_path: Path) -> Drives:
    return Drives(messages, tmp_path)


@pytest.fixture(scope="module")
def drive(messages: Any, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Returns a bag of the simulation; tests only read it."""
    return Drives(messages, tmp_path_factory.mktemp("drive")).write()


def _table(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def test_depths_of_nerfstudio_frames_lie_on_the_wall(drive: Path, tmp_path: Path) -> None:
    export_bag(drive, "nerfstudio", tmp_path / "out")
    document = json.loads((tmp_path / "out/transforms.json").read_text())
    assert document["camera_model"] == "OPENCV"
    assert len(document["frames"]) == 3
    for frame in document["frames"]:
        depth = cv2.imread(str(tmp_path / "out" / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED) / 1000.0
        T_world_optical = np.array(frame["transform_matrix"]) @ np.diag([1.0, -1.0, -1.0, 1.0])  # from OpenGL's axes
        points = _unprojected(depth, T_world_optical, frame["cx"], frame["cy"], centre=0.5)
        assert np.abs(points[:, 0] - WALL_X).max() < 1e-3
        assert (tmp_path / "out" / frame["file_path"]).is_file()


def test_depths_of_a_tum_sequence_lie_on_the_wall(drive: Path, tmp_path: Path) -> None:
    export_bag(drive, "tum", tmp_path / "out")
    camera = yaml.safe_load((tmp_path / "out/camera.yaml").read_text())
    rows = np.loadtxt(tmp_path / "out/groundtruth.txt")
    pairs = [line.split() for line in (tmp_path / "out/associations.txt").read_text().splitlines()]
    assert [pair[0] for pair in pairs] == ["0.100000000", "0.133333333", "0.200000000"]
    for row, (rgb_time, rgb, depth_time, depth_file) in zip(rows, pairs, strict=True):
        assert rgb_time == depth_time and (tmp_path / "out" / rgb).is_file()
        depth = cv2.imread(str(tmp_path / "out" / depth_file), cv2.IMREAD_UNCHANGED) / 5000.0
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = matrix_from_quat(row[4:]), row[1:4]
        points = _unprojected(depth, T, camera["k"][2], camera["k"][5], centre=0.0)
        assert np.abs(points[:, 0] - WALL_X).max() < 5e-4


def test_poses_and_stamps_in_tables_are_exact(drive: Path, tmp_path: Path) -> None:
    export_bag(drive, "png", tmp_path / "out", ExportOptions(depth="npy"))
    rows = _table(tmp_path / "out/camera/frames.csv")
    assert [int(row["stamp_ns"]) for row in rows] == list(STAMPS)
    for row, stamp in zip(rows, STAMPS, strict=True):
        pose = pose_from_matrix(_link(stamp) @ MOUNT)
        found = [float(row[name]) for name in ("x", "y", "z", "qx", "qy", "qz", "qw")]
        assert found == pytest.approx([*pose.position, *pose.quat_xyzw], abs=1e-9)
        assert np.array_equal(np.load(tmp_path / "out/camera" / row["depth"]), _depth(stamp))
    commands = _table(tmp_path / "out/cmd_vel.csv")
    assert [(int(row["stamp_ns"]), float(row["vx"])) for row in commands] == [
        (s + MS, v) for s, v in zip(STAMPS, (1, 2, 3), strict=True)
    ]
    assert len(_table(tmp_path / "out/odom.csv")) == 3


def test_poses_between_transforms_are_interpolated(drives: Drives, tmp_path: Path) -> None:
    report = export_bag(drives.write(states=False, tf=True), "png", tmp_path / "out")
    rows = _table(tmp_path / "out/camera/frames.csv")
    for row, stamp in zip(rows, STAMPS, strict=True):
        x, y, z, *_ = pose_from_matrix(_link(stamp) @ MOUNT).position
        # Error of the chord on a curve: 4 rad/s over at most 67 ms, the camera 0.1 m from the axis.
        assert [float(row[name]) for name in "xyz"] == pytest.approx([x, y, z], abs=2e-3)
    assert report.notes == []


def test_a_bag_of_a_real_robot_is_exported_without_our_topics(drives: Drives, messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "bag", reserve_bytes=0) as bag:
        bag.add_topic("/cam/color/image_raw/compressed", "sensor_msgs/msg/CompressedImage")
        bag.add_topic("/cam/aligned_depth_to_color/image_raw", "sensor_msgs/msg/Image")
        ok, jpeg = cv2.imencode(".jpg", np.full((HEIGHT, WIDTH, 3), 80, np.uint8))
        assert ok
        color = drives.filled(
            "sensor_msgs/msg/CompressedImage",
            header=messages.header(STAMPS[0], "camera_optical_frame"),
            format="jpeg",
            data=jpeg.ravel(),
        )
        bag.write("/cam/color/image_raw/compressed", messages.cdr(color), STAMPS[0], STAMPS[0])
        depth = np.full((HEIGHT, WIDTH), 1234, np.uint16)
        bag.write(
            "/cam/aligned_depth_to_color/image_raw", messages.image(STAMPS[0] + 5 * MS, depth, "16UC1"), STAMPS[0], STAMPS[0]
        )
    report = export_bag(tmp_path / "bag", "png", tmp_path / "out")
    row = _table(tmp_path / "out/cam_color/frames.csv")[0]
    assert (tmp_path / "out/cam_color" / row["rgb"]).read_bytes() == jpeg.tobytes()  # not encoded again
    assert cv2.imread(str(tmp_path / "out/cam_color" / row["depth"]), cv2.IMREAD_UNCHANGED)[0, 0] == 1234
    assert row["x"] == ""
    assert any("has no poses" in note for note in report.notes)


def test_an_image_is_not_rotated_by_its_exif_orientation_neither_decoded_nor_as_a_file() -> None:
    message = SimpleNamespace(format="jpeg", data=jpeg_with_orientation(np.full((HEIGHT, WIDTH, 3), 80, np.uint8)))
    stream = SimpleNamespace(type_name=COMPRESSED, kind="color", encoding="jpg", topic="/cam/image_raw/compressed")
    camera: Any = SimpleNamespace(streams={"rgb": stream})
    picture = CameraImage(camera, "rgb", STAMPS[0], message)
    assert picture.bgr().shape == (HEIGHT, WIDTH, 3)
    encoded = picture.encoded()
    assert encoded is not None
    assert cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_COLOR).shape == (HEIGHT, WIDTH, 3)


def test_lerobot_has_the_newest_image_state_and_command(drive: Path, tmp_path: Path) -> None:
    parquet = pytest.importorskip("pyarrow.parquet", reason="SKIPPED: LeRobot needs pyarrow: pip install pyarrow")
    export_bag(drive, "lerobot", tmp_path / "out", ExportOptions(fps=20, task="look at a wall"))
    table = parquet.read_table(tmp_path / "out/data/chunk-000/file-000.parquet").to_pydict()
    # 0.1, 0.15, 0.2 s: commands at 0.101, 0.134 and 0.201 s, odometry with the images.
    assert [action[0] for action in table["action"]] == [0.0, 2.0, 2.0]
    assert [state[:3] for state in table["observation.state"]] == [pytest.approx([0.1 * n, 0.0, 0.5]) for n in (1, 2, 3)]
    assert table["timestamp"] == pytest.approx([0.0, 0.05, 0.1])
    info = json.loads((tmp_path / "out/meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_frames"]) == ("v3.0", 20, 3)
    assert info["features"]["observation.images.camera"]["shape"] == [HEIGHT, WIDTH, 3]
    with av.open(str(tmp_path / "out/videos/observation.images.camera/chunk-000/file-000.mp4")) as video:
        greys = [int(frame.to_ndarray(format="rgb24")[15, 20, 0]) for frame in video.decode(video=0)]
    assert greys == [pytest.approx(grey, abs=6) for grey in (50, 100, 150)]
    episode = parquet.read_table(tmp_path / "out/meta/episodes/chunk-000/file-000.parquet").to_pylist()[0]
    assert (episode["length"], episode["tasks"]) == (3, ["look at a wall"])
    assert episode["videos/observation.images.camera/to_timestamp"] == pytest.approx(0.15)


def test_lerobot_without_pyarrow_names_the_remedy(drive: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gibson_sim.bags.export.lerobot.find_spec", lambda name: None)
    with pytest.raises(EnvironmentProblemError, match=r"pip install pyarrow"):
        export_bag(drive, "lerobot", tmp_path / "out")


def test_every_second_image_keeps_its_depth(drive: Path, tmp_path: Path) -> None:
    export_bag(drive, "tum", tmp_path / "out", ExportOptions(every=2))
    lines = (tmp_path / "out/associations.txt").read_text().splitlines()
    assert [line.split()[2] for line in lines] == ["0.100000000", "0.200000000"]


def test_a_lens_that_nerfstudio_lacks_is_an_error(drives: Drives, tmp_path: Path) -> None:
    with pytest.raises(RecordError, match="'rational_polynomial' with 8 numbers, which nerfstudio does not support"):
        export_bag(drives.write(model="rational_polynomial", d=8), "nerfstudio", tmp_path / "out")


def test_a_bag_without_images_is_an_error(write_drive: Callable[..., Path], messages: Any, tmp_path: Path) -> None:
    with BagWriter(tmp_path / "empty", reserve_bytes=0) as bag:
        bag.add_topic("/odom", "nav_msgs/msg/Odometry")
        bag.write("/odom", messages.odometry(5, 0.0, 0.0), 5, 5)
    with pytest.raises(RecordError, match="no images that can be exported"):
        export_bag(tmp_path / "empty", "png", tmp_path / "out")


def test_a_folder_with_content_is_left_alone(drive: Path, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out/mine.txt").write_text("keep")
    with pytest.raises(RecordError, match="is not an empty folder"):
        export_bag(drive, "png", tmp_path / "out")


def test_depth_beyond_sixteen_bits_is_zero() -> None:
    metres = np.array([[0.0004, 1.2346, 65.536, np.inf, -np.inf, np.nan]], np.float32)
    assert depth_in_units(metres, 1000.0).tolist() == [[0, 1235, 0, 0, 0, 0]]
