"""Subscribes to the images of a robot's cameras and to their camera_info, and passes on rectified views of a path's camera."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo

from gibson_path_following.errors import PathFollowingError, SettingError
from gibson_path_following.images.cameras import Calibration, ViewAssembler, ViewCamera
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.image_watch import ImageWatch
from gibson_path_following.options import PINHOLE_HFOV_DEG, CameraOptions, check_camera
from gibson_path_following.paths.stamp_filter import StampFilter, outlier_line
from gibson_path_following.types import IMAGES_OF, CameraKind, Image, View

_QOS = QoSProfile(depth=5, reliability=ReliabilityPolicy.BEST_EFFORT)
_BACK_NS = 1_000_000_000
"""Step backwards of the stamps from which on time has jumped, ns: a reset of the simulation, or a bag that plays again."""
_CLOCK_TOLERANCE_NS = 1_000_000_000
"""Difference between stamps and the node's clock of which a node warns that uses the images nevertheless, ns."""
_FAR_NS = 10_000_000_000
"""Difference that no slow machine explains, only another clock, ns."""
_PATIENCE_NS = 2_000_000_000
"""Wall time for which images may lack their camera_info, their partner or the right time before a warning, ns."""
_MIN_HFOV = math.radians(5.0)
"""Smallest field of view that a path takes from a calibration, radians."""


class CameraInput:
    """Views of one path's camera, from the topics of a node.

    Args:
        node: the node that subscribes.
        options: topics, calibration, rate.
        kind: kind of the path's camera.
        size: width and height of its images, pixels.
        hfov: its horizontal field of view, radians; None = all that the first calibrated camera sees.
        on_view: receives the stamp, ns, and the view.
        on_jump: called when stamps have gone back for good, by more than a second; it logs what the node does then.
        max_age: age of an image, seconds, from which on it is not used; nor is one whose stamp is as far in the future. None = all are used,
            whatever the node's clock says, except for a single one whose stamp is far from those before and after it.

    Raises:
        SettingError: the options do not fit the kind of camera.
    """

    def __init__(
        self, node: Any, options: CameraOptions, kind: CameraKind, size: tuple[int, int], hfov: float | None,
        on_view: Callable[[int, View], None], on_jump: Callable[[], None], max_age: float | None = None,
    ) -> None:  # fmt: skip
        check_camera(kind, options)
        self._node, self._options, self._kind, self._size = node, options, kind, size
        self.hfov = hfov
        """Horizontal field of view of the path's camera, radians; None before it is known."""
        self.problem: str | None = None
        """Why the newest image could not be used; None = it could, or there was none."""
        self._on_view, self._on_jump = on_view, on_jump
        self._max_age_ns = None if max_age is None else round(max_age * conversions.NS_PER_S)
        self._assembler: ViewAssembler[Any] = ViewAssembler(kind, round(options.sync_tolerance * conversions.NS_PER_S))
        self._cameras: dict[str, ViewCamera] = {}
        self._infos: dict[str, Calibration | SettingError | None] = {}
        """Newest calibration of each camera; None = it says that there is none; or why it cannot be used."""
        self._used_ns: int | None = None
        """Stamp of the newest view that was used, ns."""
        self._stamps: StampFilter[View] | None = StampFilter() if max_age is None else None
        """Judges the stamps of views where the clock does not."""
        self._without_info: tuple[int, tuple[Any, ...]] | None = None
        """Stamp, ns, and messages of the newest view without camera_info, which may arrive after it."""
        self._without_info_ns: int | None = None
        """Wall time of the first image that had no camera_info, ns."""
        self._off_clock_ns: int | None = None
        """Wall time since which stamps are far from the node's clock, ns; None = they are not."""
        self._incomplete_ns: int | None = None
        """Wall time of the first image since the newest complete view, ns."""
        self._period_ns = 0 if options.rate_hz == 0.0 else round(conversions.NS_PER_S / options.rate_hz)
        types = {topic: conversions.image_type(node, topic) for topic in options.image_topics}
        self._watch = ImageWatch(node, types, "parameter image_topics")
        self._subscriptions = []
        for name, topic in zip(IMAGES_OF[kind], options.image_topics, strict=True):
            self._subscriptions.append(node.create_subscription(types[topic], topic, partial(self._on_image, name, topic), _QOS))
            if options.use_camera_info:
                info = conversions.info_topic(topic)
                self._subscriptions.append(node.create_subscription(CameraInfo, info, partial(self._on_info, name), _QOS))

    def close(self) -> None:
        """Ends the subscriptions; a second call does nothing."""
        self._watch.close()
        self._without_info = None
        while self._subscriptions:
            self._node.destroy_subscription(self._subscriptions.pop())

    def _on_info(self, name: str, msg: Any) -> None:
        try:
            self._infos[name] = conversions.calibration_from(msg)
        except SettingError as error:
            # The images are not used with an older calibration: it may be that of another camera.
            self._infos[name] = error
        if self._without_info is not None and self._has_infos():
            (stamp, messages), self._without_info = self._without_info, None
            if self._max_age_ns is None or not self._is_off_clock(stamp):
                self._use(stamp, messages)

    def _on_image(self, name: str, topic: str, msg: Any) -> None:
        stamp = conversions.stamp_ns(msg.header.stamp)
        self._watch.note(topic, stamp)
        if self._is_off_clock(stamp) and self._max_age_ns is not None:
            return
        if self._used_ns is not None and stamp < self._used_ns - _BACK_NS:
            self._used_ns = None
            self._assembler.clear()
            if self._stamps is None:
                self._on_jump()
        complete = self._assembler.add(name, stamp, msg)
        if complete is None:
            self._warn_unless_complete()
            return
        self._incomplete_ns = None
        self._use(*complete)

    def _has_infos(self) -> bool:
        """Returns whether each camera that needs a camera_info has had one."""
        return not self._options.use_camera_info or all(name in self._infos for name in IMAGES_OF[self._kind])

    def _use(self, stamp: int, messages: tuple[Any, ...]) -> None:
        """Passes on the view in the messages of one time, ns, unless it comes too early for the rate or cannot be used."""
        # A tenth of tolerance: stamps of a real camera jitter.
        if self._used_ns is not None and stamp - self._used_ns < 0.9 * self._period_ns:
            return
        self._without_info = None if self._has_infos() else (stamp, messages)
        images = [self._image(*each) for each in zip(IMAGES_OF[self._kind], self._options.image_topics, messages, strict=True)]
        view = tuple(image for image in images if image is not None)
        if len(view) == len(images):
            self._used_ns, self.problem = stamp, None
            self._pass_on(stamp, view)

    def _pass_on(self, stamp_ns: int, view: View) -> None:
        """Passes on a view, unless its stamp is far from those before: then the next view shows whether time has jumped."""
        if self._stamps is None:
            self._on_view(stamp_ns, view)
            return
        passed = self._stamps.add(stamp_ns, view)
        if passed.outlier_ns is not None:
            self._node.get_logger().warning(f"images: {outlier_line(passed.outlier_ns)}", throttle_duration_sec=5.0)
        if passed.is_jump:
            self._on_jump()
        for item in passed.items:
            if self._subscriptions:  # the node may end at a jump, and at any view
                self._on_view(*item)

    def _image(self, name: str, topic: str, msg: Any) -> Image | None:
        """Returns the image in a message as the path's camera would see it; None if it cannot be used."""
        try:
            camera = self._camera(name, topic)
            if camera is None:
                return None
            return camera.image(conversions.rgb_of(msg), self._calibration(name), self._camera_hfov())
        except PathFollowingError as error:
            self.problem = f"{topic}: {error}"
            self._node.get_logger().error(self.problem, throttle_duration_sec=5.0)
            return None

    def _camera(self, name: str, topic: str) -> ViewCamera | None:
        """Returns the camera of an image; None while its camera_info is missing.

        Raises:
            SettingError: its camera_info cannot be used, or its field of view is not known.
        """
        if self._options.use_camera_info and name not in self._infos:
            now_ns = time.monotonic_ns()
            self._without_info_ns = self._without_info_ns or now_ns
            self.problem = f"no camera_info beside {topic} yet; publish it, or set use_camera_info to false"
            if now_ns - self._without_info_ns >= _PATIENCE_NS:
                self._node.get_logger().warning(self.problem, throttle_duration_sec=5.0)
            return None
        calibration = self._calibration(name)
        if calibration is None and self._camera_hfov() is None and (self._options.use_camera_info or self.hfov is None):
            use = "; or set use_camera_info to false, if it is the camera of the path" if self.hfov is not None else ""
            raise SettingError(
                f"the field of view is not known: the camera is not calibrated; set camera_hfov_deg, or publish a calibrated camera_info{use}"
            )
        if self.hfov is None:
            hfov = self._camera_hfov() if calibration is None else calibration.hfov()
            if hfov is None or hfov < _MIN_HFOV:
                raise SettingError(
                    f"camera_info: the camera sees {math.degrees(hfov or 0.0):.1f} degrees, as much to the left as to the right, must see "
                    f"{math.degrees(_MIN_HFOV):g} or more; calibrate it"
                )
            if self._kind == "pinhole" and hfov > math.radians(PINHOLE_HFOV_DEG[1]):
                raise SettingError(
                    f"the camera sees {math.degrees(hfov):.0f} degrees, a pinhole camera of a path at most {PINHOLE_HFOV_DEG[1]:g}; set hfov_deg, to "
                    "120 for example"
                )
            self.hfov = hfov
        if name not in self._cameras:
            self._cameras[name] = ViewCamera(self._kind, self._size, self.hfov)
        return self._cameras[name]

    def _calibration(self, name: str) -> Calibration | None:
        """Returns the newest calibration of a camera; None = it has none.

        Raises:
            SettingError: it cannot be used.
        """
        found = self._infos.get(name)
        if isinstance(found, SettingError):
            raise found
        return found

    def _camera_hfov(self) -> float | None:
        """Returns the field of view of an uncalibrated camera, radians; None = that of the path."""
        return math.radians(self._options.camera_hfov_deg) if self._options.camera_hfov_deg > 0.0 else None

    def _is_off_clock(self, stamp_ns: int) -> bool:
        """Returns whether a stamp is far from the node's clock; warns if that persists."""
        clock_ns = self._node.get_clock().now().nanoseconds
        ahead_ns, limit_ns = stamp_ns - clock_ns, self._max_age_ns or _CLOCK_TOLERANCE_NS
        if abs(ahead_ns) <= limit_ns:
            self._off_clock_ns = None
            return False
        now_ns = time.monotonic_ns()
        self._off_clock_ns = self._off_clock_ns or now_ns
        if now_ns - self._off_clock_ns >= _PATIENCE_NS:  # once is a reset of the simulation
            remedy = "set use_sim_time as the node of the camera has it, or synchronise the camera's clock"
            if clock_ns == 0:
                remedy = "no /clock has come: start the simulation, or set use_sim_time to false"
            elif -_FAR_NS < ahead_ns < 0:
                remedy = "camera, network or this machine is too slow, or the camera's clock is wrong"
            unused = "" if self._max_age_ns is None else f", at most {limit_ns / conversions.NS_PER_S:g} s are allowed"
            self._node.get_logger().warning(
                f"image stamps are {abs(ahead_ns) / conversions.NS_PER_S:.1f} s {'ahead of' if ahead_ns > 0 else 'behind'} this node's clock"
                f"{unused}; {remedy}",
                throttle_duration_sec=5.0,
            )
        return True

    def _warn_unless_complete(self) -> None:
        """Warns if the images of a pair have not made a view for a while."""
        now_ns = time.monotonic_ns()
        self._incomplete_ns = self._incomplete_ns or now_ns
        if now_ns - self._incomplete_ns < _PATIENCE_NS:
            return
        missing, gap_ns = self._assembler.missing, self._assembler.gap_ns
        if gap_ns is None:
            others = " and ".join(name for name in IMAGES_OF[self._kind] if name not in missing)
            self.problem = f"images come from {others}, but not from {' and '.join(missing)}; do all cameras run?"
            if self._watch.is_waiting:  # it warns
                return
        else:
            self.problem = (
                f"the images of {' and '.join(IMAGES_OF[self._kind])} are {gap_ns / 1e6:.0f} ms apart by their stamps, sync_tolerance allows "
                f"{self._options.sync_tolerance * 1e3:g} ms; trigger the cameras at the same time, or set a larger sync_tolerance"
            )
        self._node.get_logger().warning(self.problem, throttle_duration_sec=5.0)
