"""Occupancy grids."""

from __future__ import annotations

from array import array
from typing import TYPE_CHECKING

import numpy as np
from nav_msgs.msg import MapMetaData, OccupancyGrid

from gibson_sim.ros.conversions.basics import header_to_msg, time_to_msg

if TYPE_CHECKING:  # SciPy with it: 0.4 s that a render node, which has no map, would lose whenever it starts
    from gibson_sim.scenes.floor_map import FloorMap

_FREE, _OCCUPIED, _UNKNOWN = 0, 100, -1


def floor_map_to_msg(floor: FloorMap, floor_z: float, stamp_ns: int, frame_id: str) -> OccupancyGrid:
    """Returns the map of a floor: 0 = free, 100 = occupied, -1 = neither floor nor obstacle. Rows run along y, from the lowest."""
    cells = np.full(floor.shape, _UNKNOWN, dtype=np.int8)
    cells[floor.free] = _FREE
    cells[floor.occupied] = _OCCUPIED
    msg = OccupancyGrid(header=header_to_msg(stamp_ns, frame_id))
    msg.info = MapMetaData(map_load_time=time_to_msg(stamp_ns), resolution=floor.resolution)
    msg.info.height, msg.info.width = floor.shape
    msg.info.origin.position.x, msg.info.origin.position.y = floor.origin
    msg.info.origin.position.z = floor_z
    msg.data = array("b", cells.tobytes())
    return msg
