"""Point clouds."""

from __future__ import annotations

from array import array

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2, PointField

from gibson_sim.ros.conversions.basics import header_to_msg


def cloud_to_msg(cloud: NDArray[np.void], stamp_ns: int, frame_id: str) -> PointCloud2:
    """Returns an organised cloud.

    Args:
        cloud: (H, W), C-contiguous, with four-byte fields; all are declared as float32, ``rgb`` too, as PCL and rviz want it.
        stamp_ns: of the image that it was made from.
        frame_id: the frame of its points.
    """
    height, width = cloud.shape
    data = array("B")
    data.frombytes(np.ascontiguousarray(cloud).view(np.uint8).data)
    msg = PointCloud2(header=header_to_msg(stamp_ns, frame_id), height=height, width=width)
    msg.fields = [
        PointField(name=name, offset=int(field[1]), datatype=PointField.FLOAT32, count=1)
        for name, field in (cloud.dtype.fields or {}).items()
    ]
    msg.is_bigendian = False
    msg.point_step, msg.row_step = cloud.dtype.itemsize, cloud.dtype.itemsize * width
    msg.is_dense = False  # where nothing was seen there are NaNs
    msg.data = data
    return msg
