"""Synthetic bags: messages of the Jazzy types in rosbags, without ROS."""

from __future__ import annotations

import os
import subprocess
import warnings
from collections.abc import Callable, Collection, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from gibson_sim.bags.writer import BagWriter, TopicQos

NS = 1_000_000_000
PERIOD_NS = 100_000_000


class Messages:
    """Builds CDR bytes of messages."""

    def __init__(self, source: Path) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        types: dict[str, Any] = {}
        for path in sorted((source / "src/gibson_msgs/msg").glob("*.msg")):
            types.update(get_types_from_msg(path.read_text(), f"gibson_msgs/msg/{path.stem}"))
        self.store.register(types)
        self.types = self.store.types

    def cdr(self, message: Any) -> bytes:
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def filled(self, type_name: str, /, **values: Any) -> Any:
        """Returns a message whose other fields are zero, empty or false."""
        fields = self.store.fielddefs[type_name][1]
        return self.types[type_name](**{field: values.get(field, self._nothing(desc)) for field, desc in fields})

    def _nothing(self, desc: Any) -> Any:
        kind, rest = desc
        if kind.name == "NAME":
            return self.filled(rest)
        if kind.name == "BASE":
            return "" if rest[0] == "string" else rest[0] == "bool" and False
        inner, length = rest
        return np.zeros(length) if inner[0].name == "BASE" and inner[1][0] != "string" else []

    def time(self, ns: int) -> Any:
        return self.types["builtin_interfaces/msg/Time"](sec=ns // NS, nanosec=ns % NS)

    def header(self, ns: int, frame: str = "odom") -> Any:
        return self.types["std_msgs/msg/Header"](stamp=self.time(ns), frame_id=frame)

    def image(self, ns: int, pixels: np.ndarray, encoding: str, padding: int = 0) -> bytes:
        rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
        rows = np.pad(rows, ((0, 0), (0, padding)))
        return self.cdr(
            self.types["sensor_msgs/msg/Image"](
                header=self.header(ns, "camera_optical_frame"),
                height=pixels.shape[0],
                width=pixels.shape[1],
                encoding=encoding,
                is_bigendian=0,
                step=rows.shape[1],
                data=rows.reshape(-1),
            )
        )

    def camera_info(self, ns: int, width: int = 8, height: int = 6) -> bytes:
        roi = self.types["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0, do_rectify=False)
        k = np.eye(3).reshape(-1)
        return self.cdr(
            self.types["sensor_msgs/msg/CameraInfo"](
                header=self.header(ns, "camera_optical_frame"), height=height, width=width, distortion_model="plumb_bob",
                d=np.zeros(5), k=k, r=k, p=np.zeros(12), binning_x=0, binning_y=0, roi=roi,
            )
        )  # fmt: skip

    def odometry(self, ns: int, x: float, y: float, yaw: float = 0.0, z: float = 0.0) -> bytes:
        t = self.types
        zero = t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0)
        pose = t["geometry_msgs/msg/Pose"](
            position=t["geometry_msgs/msg/Point"](x=x, y=y, z=z),
            orientation=t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))),
        )
        return self.cdr(
            t["nav_msgs/msg/Odometry"](
                header=self.header(ns),
                child_frame_id="base_footprint",
                pose=t["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=np.zeros(36)),
                twist=t["geometry_msgs/msg/TwistWithCovariance"](
                    twist=t["geometry_msgs/msg/Twist"](linear=zero, angular=zero), covariance=np.zeros(36)
                ),
            )
        )

    def twist_stamped(self, ns: int, linear: float, angular: float = 0.0) -> bytes:
        t = self.types
        vector = t["geometry_msgs/msg/Vector3"]
        twist = t["geometry_msgs/msg/Twist"](linear=vector(x=linear, y=0.0, z=0.0), angular=vector(x=0.0, y=0.0, z=angular))
        return self.cdr(t["geometry_msgs/msg/TwistStamped"](header=self.header(ns), twist=twist))

    def collisions(self, ns: int, count: int, ongoing: int, body: str, force: float = 0.0) -> bytes:
        return self.cdr(
            self.types["gibson_msgs/msg/CollisionCount"](
                header=self.header(ns),
                count=count,
                ongoing=ongoing,
                duration=0.0,
                greatest_force=force,
                last_link="base",
                last_body=body,
            )
        )

    def contacts(self, ns: int, *points: tuple[str, str, str, float, float]) -> bytes:
        """``points``: body a, body b, link b, vertical part of the normal from b to a, force in newtons."""
        t = self.types
        made = [
            t["gibson_msgs/msg/Contact"](
                body_a=a, link_a="base", body_b=b, link_b=link, position=t["geometry_msgs/msg/Point"](x=0.0, y=0.0, z=0.0),
                normal=t["geometry_msgs/msg/Vector3"](x=1.0 - rises, y=0.0, z=rises), force=force, distance=0.0,
            )
            for a, b, link, rises, force in points
        ]  # fmt: skip
        return self.cdr(t["gibson_msgs/msg/Contacts"](header=self.header(ns, "map"), contacts=made))

    def flag(self, value: bool) -> bytes:
        return self.cdr(self.types["std_msgs/msg/Bool"](data=value))

    def transform(self, ns: int, child: str) -> bytes:
        t = self.types
        return self.cdr(
            t["tf2_msgs/msg/TFMessage"](
                transforms=[
                    t["geometry_msgs/msg/TransformStamped"](
                        header=self.header(ns),
                        child_frame_id=child,
                        transform=t["geometry_msgs/msg/Transform"](
                            translation=t["geometry_msgs/msg/Vector3"](x=0.0, y=0.0, z=0.0),
                            rotation=t["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=0.0, w=1.0),
                        ),
                    )
                ]
            )
        )

    def scene_state(self, ns: int, step: int) -> bytes:
        return self.cdr(
            self.types["gibson_msgs/msg/SceneState"](
                header=self.header(ns, "map"), revision=1, step=step, epoch_step=step, epoch=0, poses=np.arange(7.0), twists=np.zeros(6),
                due_cameras=np.array([0], dtype=np.uint32),
            )
        )  # fmt: skip

    def scene(self, camera_rate_hz: float) -> bytes:
        camera = self.filled("gibson_msgs/msg/Camera", name="camera", rate=camera_rate_hz)
        return self.cdr(self.filled("gibson_msgs/msg/Scene", revision=1, links=["robot/base_footprint"], cameras=[camera]))

    def text(self, value: str) -> bytes:
        return self.cdr(self.types["std_msgs/msg/String"](data=value))


@pytest.fixture(scope="session")
def messages(root: Path) -> Messages:
    return Messages(root)


@pytest.fixture
def write_drive(messages: Messages, tmp_path: Path) -> Callable[..., Path]:
    """Returns a function that writes a short drive: 1 m along x in 10 steps of 0.1 s, with a camera of 8 x 6 pixels.

    With ``camera_rate_hz`` the bag has the scene, too, with the camera's rate.
    """

    def write(
        folder: str = "drive",
        *,
        image_shift_ns: int = 0,
        skip_images: Collection[int] = (),
        frames: int = 11,
        camera_rate_hz: float = 0.0,
    ) -> Path:
        path = tmp_path / folder
        with BagWriter(path, reserve_bytes=0, chunk_bytes=2000) as bag:
            topics = SimpleNamespace(rgb="/camera/image_raw", depth="/camera/depth/image_raw")
            for topic in (topics.rgb, topics.depth):
                bag.add_topic(topic, "sensor_msgs/msg/Image")
                bag.add_topic(topic.replace("image_raw", "camera_info"), "sensor_msgs/msg/CameraInfo")
            for topic in ("/odom", "/ground_truth/odom"):
                bag.add_topic(topic, "nav_msgs/msg/Odometry")
            bag.add_topic("/tf", "tf2_msgs/msg/TFMessage")
            bag.add_topic("/tf_static", "tf2_msgs/msg/TFMessage", TopicQos.latched())
            bag.add_topic("/scene_state", "gibson_msgs/msg/SceneState")
            bag.write("/tf_static", messages.transform(0, "camera_link"), NS, NS)
            if camera_rate_hz:
                bag.add_topic("/scene", "gibson_msgs/msg/Scene", TopicQos.latched())
                bag.write("/scene", messages.scene(camera_rate_hz), NS, NS)
            for i in range(frames):
                now = NS + i * PERIOD_NS
                bag.write("/odom", messages.odometry(now, 0.1 * i, 0.0), now, now)
                bag.write("/ground_truth/odom", messages.odometry(now, 2.0, 3.0 + 0.1 * i, np.pi / 2), now, now)
                bag.write("/tf", messages.transform(now, "base_footprint"), now, now)
                bag.write("/scene_state", messages.scene_state(now, i), now, now)
                if i in skip_images:
                    continue
                stamp = now + image_shift_ns
                rgb = np.full((6, 8, 3), (200, 100, 10 * i), dtype=np.uint8)
                depth = np.full((6, 8), 1.0, dtype=np.float32)
                depth[0] = np.inf
                images = {topics.rgb: messages.image(stamp, rgb, "rgb8"), topics.depth: messages.image(stamp, depth, "32FC1")}
                for topic, image in images.items():
                    bag.write(topic, image, now, now)
                    bag.write(topic.replace("image_raw", "camera_info"), messages.camera_info(stamp), now, now)
        return path

    return write


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 24 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    command = ["mount", "-t", "tmpfs", "-o", "size=24m", "tmpfs", str(folder)]
    if os.geteuid() != 0 or subprocess.run(command, capture_output=True, check=False).returncode:
        message = "SKIPPED: a small disk cannot be mounted here (needs root); the file size limit is tested instead"
        warnings.warn(message, stacklevel=2)
        pytest.skip(message)
    yield folder
    subprocess.run(["umount", "-l", str(folder)], check=True)
