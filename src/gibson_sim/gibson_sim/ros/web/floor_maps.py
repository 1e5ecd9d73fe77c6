"""The maps of all floors, for a page."""

from __future__ import annotations

import math
import re
from functools import partial
from typing import Any, NamedTuple

import cv2
import numpy as np
from nav_msgs.msg import OccupancyGrid

from gibson_sim.maps.floor_map import floor_at
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.web.robots import GraphNode
from gibson_sim.web.server import PageServer

_FLOOR_MAP = re.compile(r"/" + names.floor_map(0).replace("0", r"\d+"))
_GRID = "nav_msgs/msg/OccupancyGrid"
_MAX_FLOORS = 50
"""Largest number of floors whose maps are shown."""
_MAX_CELLS = 100_000_000


class _Map(NamedTuple):
    z: float
    values: dict[str, Any]


class FloorMaps:
    """Maps for a page: one of each floor of a house; ``map`` alone where there are no others.

    Subscribes:
        map (nav_msgs/OccupancyGrid): the map of one floor, which may be made by a SLAM node.
        floor_N/map (nav_msgs/OccupancyGrid): the map of each floor of a simulation with several.
    """

    def __init__(self, node: GraphNode, server: PageServer) -> None:
        self._node, self._server = node, server
        self._maps: dict[str, _Map] = {}
        """Topic -> map."""
        self._version = 0
        self._floor_subscriptions: dict[str, Any] = {}
        node.subscribe(OccupancyGrid, names.MAP, partial(self._on_map, names.MAP), qos.LATCHED)

    @property
    def heights(self) -> tuple[float, ...]:
        """Heights of the floors in increasing order, m; at least one."""
        floors = {shown.z for topic, shown in self._maps.items() if topic != names.MAP}
        return tuple(sorted(floors)) or (self._maps[names.MAP].z if names.MAP in self._maps else 0.0,)

    def floor_at(self, z: float) -> int:
        """Returns the index in ``heights`` of the floor on which a point is; ``z`` in the map frame, m."""
        return floor_at(self.heights, z)

    def update(self, graph: list[tuple[str, list[str]]]) -> None:
        """Subscribes to the maps of floors that have appeared, and forgets those that have gone; ``graph`` as rclpy returns it."""
        found = [topic for topic, types in graph if _GRID in types and _FLOOR_MAP.fullmatch(topic)]
        present = {topic for topic in found if self._node.count_publishers(topic)}
        for topic in self._floor_subscriptions.keys() - present:
            self._node.destroy_subscription(self._floor_subscriptions.pop(topic))
            if self._maps.pop(topic, None) is not None:
                self._send()
        for topic in sorted(present - self._floor_subscriptions.keys())[: _MAX_FLOORS - len(self._floor_subscriptions)]:
            self._floor_subscriptions[topic] = self._node.subscribe(
                OccupancyGrid, topic, partial(self._on_map, topic), qos.LATCHED
            )

    def _on_map(self, topic: str, msg: OccupancyGrid) -> None:
        info, origin = msg.info, msg.info.origin.position
        if not 0 < info.width * info.height <= _MAX_CELLS or len(msg.data) != info.width * info.height:
            return
        if not all(map(math.isfinite, (info.resolution, origin.x, origin.y, origin.z))):
            raise ValueError("its resolution or its origin is not finite")
        cells = np.asarray(msg.data, dtype=np.int8).reshape(info.height, info.width)
        pixels = np.full((*cells.shape, 4), (0, 0, 0, 0), dtype=np.uint8)
        pixels[cells >= 0] = (255, 255, 255, 255)
        pixels[cells >= 50] = (60, 50, 45, 255)
        self._version += 1
        blob = topic.strip("/").replace("/", "_")
        self._server.serve_blob(blob, bytes(cv2.imencode(".png", pixels[::-1])[1]))
        values = {"data": blob, "version": self._version, "width": info.width, "height": info.height}
        values |= {"resolution": info.resolution, "x": origin.x, "y": origin.y}
        self._maps[topic] = _Map(float(origin.z), values)
        self._send()

    def _send(self) -> None:
        """Sends the maps of all floors, the lowest first: ``map`` takes the place of the map of its floor."""
        heights = self.heights
        shown: list[dict[str, Any] | None] = [None] * len(heights)
        for topic in sorted(self._maps, key=lambda topic: topic == names.MAP):
            shown[floor_at(heights, self._maps[topic].z)] = self._maps[topic].values
        floors = [{"z": z, "map": values} for z, values in zip(heights, shown, strict=True)]
        self._server.broadcast("floors", floors, keep=True)
