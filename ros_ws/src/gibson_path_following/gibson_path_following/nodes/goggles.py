"""``goggles``: adapts a camera's images to the appearance of the simulator, in which the networks of a robot were trained."""

from __future__ import annotations

import time
from typing import Any

from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CameraInfo, Image

from gibson_path_following.errors import PathFollowingError, SettingError, quoted
from gibson_path_following.images.goggles import load_reference, make_goggles
from gibson_path_following.images.image_queue import ImageCounts, ImageQueue
from gibson_path_following.nodes import conversions
from gibson_path_following.nodes.camera_infos import CameraInfos
from gibson_path_following.nodes.image_watch import ImageWatch
from gibson_path_following.nodes.parameters import declared
from gibson_path_following.nodes.running import pop_queue, run_node
from gibson_path_following.options import GogglesOptions

_DEPTH = 30
"""Messages that the middleware holds while an image is adapted: all are counted if no more arrive in that time."""
_NEWEST = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.BEST_EFFORT)
_ALL = QoSProfile(depth=_DEPTH, reliability=ReliabilityPolicy.RELIABLE)
_OUTPUT = QoSProfile(depth=5, reliability=ReliabilityPolicy.RELIABLE)
"""As camera drivers publish (REP 2003): subscribers with either reliability receive the images."""
_COUNTS_PERIOD_S = 10
"""Time between two lines with the counts of images, seconds of wall time."""


_INFO_TIMEOUT_S = 0.05
"""Timeout for the camera_info of the first image of a new size, seconds of wall time."""


class GogglesNode(Node):
    """Adapts images to the appearance of the simulator; stamp, frame and size stay the same.

    Images that arrive while one is adapted are skipped, except for the newest one; queue_size lets them wait.

    Parameters: the fields of ``gibson_path_following.options.GogglesOptions``.

    Subscribes:
        camera/image_raw (sensor_msgs/Image), or ``image_topic``; camera/camera_info beside it.

    Publishes:
        goggles/image_raw (sensor_msgs/Image, rgb8) and, with the stamp of each image, goggles/camera_info, both reliable: give
        ``path_policy`` the parameter image_topics: [goggles/image_raw].
    """

    def __init__(self, **kwargs: Any) -> None:
        """Reads the parameters and loads the network. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            PathFollowingError: a parameter, or a file that it names, cannot be used.
        """
        super().__init__("goggles", **kwargs)
        o = declared(self, GogglesOptions)
        self.exit_code: int | None = None
        self._goggles = make_goggles(o.mode, o.model, None if o.mode == "learned" else load_reference(o.reference))
        self._image_pub = self.create_publisher(Image, "goggles/image_raw", _OUTPUT)
        self._info_pub = self.create_publisher(CameraInfo, "goggles/camera_info", _OUTPUT)
        self._topic = o.image_topic
        info_topic = conversions.info_topic(o.image_topic)
        self._check_inputs(o.image_topic, info_topic)
        self._queue: ImageQueue[Any] = ImageQueue(o.queue_size)
        self._infos = CameraInfos(_DEPTH + o.queue_size)
        self._size: tuple[int, int] | None = None
        """Width and height of the newest adapted image, pixels."""
        self._logged = ImageCounts()
        """Counts at the last line about them."""
        kind = conversions.image_type(self, o.image_topic)
        self._image_sub = self.create_subscription(
            kind,
            o.image_topic,
            self._on_image,
            _ALL if o.queue_size > 1 else _NEWEST,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible_qos),
        )
        self._info_sub = self.create_subscription(CameraInfo, info_topic, self._infos.add, _NEWEST)
        self._has_waiting = self.create_guard_condition(self._adapt_next)
        self._watch = ImageWatch(self, {o.image_topic: kind}, "parameter image_topic")
        self.create_timer(_COUNTS_PERIOD_S, self._log_counts, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _check_inputs(self, *topics: str) -> None:
        """Raises SettingError if the node would receive what it publishes."""
        outputs = [publisher.topic_name for publisher in (self._image_pub, self._info_pub)]
        for name in map(self.resolve_topic_name, topics):
            if name in outputs:
                raise SettingError(
                    f"parameter image_topic is {quoted(self._topic)}, but {name} is an output of this node; choose the topic of the camera's "
                    "images, such as camera/image_raw"
                )

    def _on_incompatible_qos(self, _: Any) -> None:
        """Logs that a publisher of images is best effort: the only policy that may not match."""
        self.get_logger().warning(
            f"the images on {self._image_sub.topic_name} are published best effort, and queue_size {self._queue.size} needs reliable ones; set it "
            "to 1, or the publisher's reliability to reliable"
        )

    def _on_image(self, msg: Any) -> None:
        self._receive(msg)
        self._adapt_next()

    def _receive(self, msg: Any) -> None:
        self._watch.note(self._topic, conversions.stamp_ns(msg.header.stamp))
        self._queue.add(msg)

    def _adapt_next(self) -> None:
        """Adapts the oldest image of the queue, and comes back for the others."""
        for msg in pop_queue(self._image_sub):
            self._receive(msg)
        image = self._queue.pop()
        if image is None:
            return
        try:
            adapted = self._goggles(conversions.rgb_of(image))
        except PathFollowingError as error:
            self._queue.note_result(usable=False)
            self.get_logger().error(f"{self._topic}: {error}", throttle_duration_sec=5.0)
        else:
            self._publish(image.header, adapted)
            self._queue.note_result(usable=True)
        if self._queue.waiting:
            self._has_waiting.trigger()

    def _publish(self, header: Any, adapted: Any) -> None:
        """Publishes an image, (H, W, 3), uint8, and its camera_info."""
        height, width = adapted.shape[:2]
        out = Image(header=header, height=height, width=width, encoding="rgb8", step=3 * width)
        out.data = adapted.tobytes()
        info = self._info(header, width, height)
        if info is not None:
            self._info_pub.publish(info)
        elif (newest := self._infos.newest) is not None:
            self.get_logger().warning(
                f"an image has {width}x{height} pixels, {self._info_sub.topic_name} is of {newest.width}x{newest.height}: such images are published "
                "without camera_info; publish that of the same camera and size",
                throttle_duration_sec=5.0,
            )
        self._image_pub.publish(out)

    def _info(self, header: Any, width: int, height: int) -> Any | None:
        """Returns the camera_info of an image; None = there is none.

        Waits for that of the first image of a new size: most cameras publish it just after the image.
        """
        is_new, self._size = (width, height) != self._size, (width, height)
        may_wait = is_new and self.count_publishers(self._info_sub.topic_name) > 0
        end = time.monotonic() + _INFO_TIMEOUT_S
        while True:
            for msg in pop_queue(self._info_sub):
                self._infos.add(msg)
            info = self._infos.of_image(header, width, height)
            if info is not None or self._infos.has_stamp(header) or not may_wait or time.monotonic() > end:
                return info
            time.sleep(0.002)

    def _log_counts(self) -> None:
        counts = self._queue.counts
        new, self._logged = counts.since(self._logged), counts
        if new != ImageCounts():
            waiting = f", {self._queue.waiting} waiting" if self._queue.waiting else ""
            self.get_logger().info(f"images in {_COUNTS_PERIOD_S} s: {new}{waiting}")

    def stop(self) -> None:
        """Ends the warnings, and logs how many images were adapted."""
        self._watch.close()
        self._queue.close()
        self.get_logger().info(f"images in all: {self._queue.counts}")


def main(args: list[str] | None = None) -> None:
    """Runs the node."""
    run_node(GogglesNode, GogglesOptions, args)


if __name__ == "__main__":
    main()
