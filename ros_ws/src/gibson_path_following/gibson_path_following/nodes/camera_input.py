"""Subscribes to the images of a robot's cameras and to their camera_info, and passes on rectified views of a path's camera."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, CompressedImage, Image as ImageMsg

from gibson_path_following.cameras import Calibration, ViewAssembler, ViewCamera
from gibson_path_following.errors import PathFollowingError, SettingError
from gibson_path_following.nodes import conversions
from gibson_path_following.options import CameraOptions, check_topics
from gibson_path_following.types import IMAGES_OF, CameraKind, View

_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
_BACK_NS = 1_000_000_000
"""Step backwards of the stamps from which on time has jumped, ns: a reset of the simulation, or a bag that plays again."""

_INFO_TIMEOUT_NS = 2_000_000_000
"""Time that images may arrive without camera_info before a warning, ns."""


class CameraInput:
    """Views of one path's camera, from the topics of a node.

    Args:
        node: the node that subscribes.
        options: topics, calibration, rate.
        kind: kind of the path's camera.
        size: width and height of its images, pixels.
        hfov: its horizontal field of view, radians; None = all that the first calibrated camera sees.
        on_view: receives the stamp, ns, and the view.
        on_jump: called when stamps have gone back by more than a second; it says what the node does then.

    Raises:
        SettingError: the number of topics is not that of the camera's images.
    """

    def __init__(
        self, node: Any, options: CameraOptions, kind: CameraKind, size: tuple[int, int], hfov: float | None,
        on_view: Callable[[int, View], None], on_jump: Callable[[], None],
    ) -> None:  # fmt: skip
        check_topics(kind, options.image_topics)
        self._node, self._options, self._kind, self._size = node, options, kind, size
        self.hfov = hfov
        """Horizontal field of view of the path's camera, radians; None before it is known."""
        self._on_view, self._on_jump = on_view, on_jump
        self._assembler = ViewAssembler(kind, round(options.sync_tolerance * conversions.NS_PER_S))
        self._cameras: dict[str, ViewCamera] = {}
        self._infos: dict[str, Calibration | None] = {}
        self._used_ns: dict[str, int] = {}
        """Stamp of the newest image that was used, by camera, ns."""
        self._has_image = False
        """Whether any image has arrived, usable or not."""
        self._waiting_ns: int | None = None
        """Stamp of the first image that had no camera_info, ns."""
        self._period_ns = 0 if options.rate_hz == 0.0 else round(conversions.NS_PER_S / options.rate_hz)
        self._subscriptions = []
        for name, topic in zip(IMAGES_OF[kind], options.image_topics, strict=True):
            compressed = topic.endswith("/compressed")
            of = CompressedImage if compressed else ImageMsg
            self._subscriptions.append(
                node.create_subscription(of, topic, partial(self._on_image, name, topic, compressed), _QOS)
            )
            if options.use_camera_info:
                info = topic.removesuffix("/compressed").rpartition("/")[0]
                self._subscriptions.append(
                    node.create_subscription(
                        CameraInfo, f"{info}/camera_info" if info else "camera_info", partial(self._on_info, name), _QOS
                    )
                )

    def warn_if_no_image(self) -> None:
        """Warns every 5 s while no image has arrived: a topic name may be wrong."""
        if not self._has_image:
            self._node.get_logger().warning(
                f"no image has come from {', '.join(self._options.image_topics)}; does the camera run, and is parameter image_topics right?",
                throttle_duration_sec=5.0, skip_first=True,
            )  # fmt: skip

    def close(self) -> None:
        """Ends the subscriptions; a second call does nothing."""
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())

    def _on_info(self, name: str, msg: Any) -> None:
        try:
            self._infos[name] = conversions.calibration_from(msg)
        except SettingError as error:
            self._node.get_logger().error(str(error), throttle_duration_sec=5.0)

    def _on_image(self, name: str, topic: str, compressed: bool, msg: Any) -> None:
        self._has_image = True
        stamp = conversions.stamp_ns(msg.header.stamp)
        used = self._used_ns.get(name)
        if used is not None and stamp < used - _BACK_NS:
            self._used_ns.clear()
            self._on_jump()
            if not self._subscriptions:
                return
            used = None
        # A tenth of tolerance: stamps of a real camera jitter.
        if used is not None and stamp - used < 0.9 * self._period_ns:
            return
        try:
            camera = self._camera(name, topic, stamp)
            if camera is None:
                return
            rgb = conversions.rgb_of_compressed(msg) if compressed else conversions.rgb_of_image(msg)
            view = self._assembler.add(name, stamp, camera.image(rgb, self._infos.get(name), self._camera_hfov()))
        except PathFollowingError as error:
            self._node.get_logger().error(f"{topic}: {error}", throttle_duration_sec=5.0)
            return
        self._used_ns[name] = stamp
        if view is not None:
            self._on_view(*view)

    def _camera(self, name: str, topic: str, stamp: int) -> ViewCamera | None:
        """Returns the camera of an image; None while its camera_info or its field of view is not known."""
        if self._options.use_camera_info and name not in self._infos:
            self._waiting_ns = min(stamp, self._waiting_ns or stamp)
            if stamp - self._waiting_ns < _INFO_TIMEOUT_NS:
                return None
            self._node.get_logger().warning(
                f"no camera_info beside {topic} yet; publish it, or set use_camera_info to false", throttle_duration_sec=5.0
            )
            return None
        if self.hfov is None:
            calibration = self._infos.get(name)
            self.hfov = calibration.hfov() if calibration is not None else self._camera_hfov()
            if self.hfov is None:
                raise SettingError(
                    f"the field of view of {topic} is not known: it is not calibrated; set camera_hfov_deg, or publish a calibrated camera_info"
                )
        if name not in self._cameras:
            self._cameras[name] = ViewCamera(self._kind, self._size, self.hfov)
        return self._cameras[name]

    def _camera_hfov(self) -> float | None:
        """Returns the field of view of an uncalibrated camera, radians; None = that of the path."""
        return math.radians(self._options.camera_hfov_deg) if self._options.camera_hfov_deg > 0.0 else None
