"""sensor_msgs/Image as bytes: a tenth of the time that a message object takes, since the pixels are copied once.

Imports no ROS: the layout is that of XCDR 1, little-endian, as in ``fast_publish``.
"""

from __future__ import annotations

import struct
from typing import Any

from numpy.typing import NDArray

from gibson_sim.types import NS_PER_S

_ENCAPSULATION = b"\x00\x01\x00\x00"


def image_to_bytes(pixels: NDArray[Any], encoding: str, stamp_ns: int, frame_id: str) -> bytes:
    """Returns what ``serialize_message(image_to_msg(...))`` returns, of C-contiguous ``pixels``, (H, W) or (H, W, C)."""
    height, width = pixels.shape[:2]
    head = struct.pack("<iI", *divmod(stamp_ns, NS_PER_S)) + _string(frame_id)
    head += bytes(-len(head) % 4) + struct.pack("<II", height, width) + _string(encoding)
    head += b"\x00"  # little-endian
    head += bytes(-len(head) % 4) + struct.pack("<II", pixels.strides[0], pixels.nbytes)
    return b"".join((_ENCAPSULATION, head, pixels.data.cast("B")))


def _string(text: str) -> bytes:
    data = text.encode() + b"\x00"
    return struct.pack("<I", len(data)) + data
