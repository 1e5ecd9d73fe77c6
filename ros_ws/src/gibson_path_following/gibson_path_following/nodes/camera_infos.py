"""Finds the camera_info of an image, so that a node that republishes images can publish both with one stamp."""

from __future__ import annotations

import copy
from typing import Any

from gibson_path_following.nodes.conversions import stamp_ns


class CameraInfos:
    """The newest ``sensor_msgs/CameraInfo`` messages of a camera.

    Args:
        kept: number of messages that are kept.
    """

    def __init__(self, kept: int) -> None:
        self._kept = kept
        self._by_stamp: dict[int, Any] = {}
        """Stamp, ns -> message, in the order of arrival."""

    @property
    def newest(self) -> Any | None:
        """The message that came last; None = none has come."""
        return next(reversed(self._by_stamp.values()), None)

    def add(self, msg: Any) -> None:
        """Adds a message."""
        ns = stamp_ns(msg.header.stamp)
        self._by_stamp.pop(ns, None)
        self._by_stamp[ns] = msg
        if len(self._by_stamp) > self._kept:
            del self._by_stamp[next(iter(self._by_stamp))]

    def has_stamp(self, header: Any) -> bool:
        """Returns whether the message with the stamp of an image has come, and is kept."""
        return stamp_ns(header.stamp) in self._by_stamp

    def of_image(self, header: Any, width: int, height: int) -> Any | None:
        """Returns the camera_info of an image, with its stamp.

        It is the message with that stamp or, if that has not come, the newest one of the image's size, with the image's header.
        A message with that stamp and another size is not replaced by an older one.

        Args:
            header: header of the image.
            width: its width, pixels.
            height: its height, pixels.

        Returns:
            A ``sensor_msgs/CameraInfo``; None = none of the kept ones fits.
        """
        if (same := self._by_stamp.get(stamp_ns(header.stamp))) is not None:
            return same if _fits(same, width, height) else None
        fitting = (msg for msg in reversed(self._by_stamp.values()) if _fits(msg, width, height))
        if (newest := next(fitting, None)) is None:
            return None
        info = copy.copy(newest)
        info.header = header
        return info


def _fits(info: Any, width: int, height: int) -> bool:
    """Returns whether images of a size, pixels, can be those of a camera_info: its own size, or that of its region and binning (REP 104).

    A camera that is not calibrated may leave out the size.
    """
    region = (info.roi.width or info.width, info.roi.height or info.height)
    binned = (region[0] // max(1, info.binning_x), region[1] // max(1, info.binning_y))
    return (width, height) in ((info.width, info.height), binned) or (info.width, info.height, info.k[0]) == (0, 0, 0.0)
