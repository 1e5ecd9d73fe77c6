"""The entities of a simulation and the rooms that they are in, for a page."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection
from functools import partial
from typing import Any

from simulation_interfaces.srv import GetEntityInfo, GetNamedPoseBounds

from gibson_sim.ros.client.simulation_client import SimulationClient, is_success

_AT_ONCE = 8
"""Largest number of calls for classes and rooms that are pending at once."""
_INFO, _BOUNDS = "get_entity_info", "get_named_pose_bounds"
_ROOM = "room"
"""Tag of the named poses of rooms."""
_MAX_TEXT = 100
"""Largest length of a class that a page shows, characters."""


class Entities:
    """Robots, bodies and named poses, as the services of ``simulation_interfaces`` describe them.

    Services used:
        get_entity_info: the class of each entity, once.
        get_named_pose_bounds: the extent of each room, once; without it, or without rooms, a page does not group by rooms.

    Args:
        simulation: client of the simulation.
        floor_at: returns the index of the floor on which a point is, by its height, m.
    """

    def __init__(self, simulation: SimulationClient, floor_at: Callable[[float], int]) -> None:
        self._simulation, self._floor_at = simulation, floor_at
        for service in (_INFO, _BOUNDS):
            simulation.prepare(service)
        self._classes: dict[str, str | None] = {}
        """Entity -> class; None = the call is pending."""
        self._rooms: dict[str, dict[str, Any] | None] = {}
        """Named pose of a room -> values for the page; None = the call is pending."""
        self.places: dict[str, tuple[float, float, int]] = {}
        """Entity -> x, y on the map, m, and the index of its floor."""

    def clear(self) -> None:
        """Forgets everything: the simulation has ended."""
        self._classes, self._rooms, self.places = {}, {}, {}

    def values(self, response: Any, robots: Collection[str]) -> list[dict[str, Any]]:
        """Returns the values for the page: name, pose (m, rad), floor and class of each entity, and whether it is a robot.

        Args:
            response: response of GetEntitiesStates.
            robots: namespaces of the robots.
        """
        rows = []
        self.places = {}
        for name, state in zip(response.entities, response.states, strict=False):
            p, q = state.pose.position, state.pose.orientation
            yaw = math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
            if math.isfinite(p.x + p.y + p.z + yaw):
                floor = self._floor_at(p.z)
                self.places[name] = (p.x, p.y, floor)
                is_robot = name in robots or name.rpartition("/")[2] == "robot"
                rows.append(
                    {
                        "name": name, "x": round(p.x, 4), "y": round(p.y, 4), "z": round(p.z, 4), "yaw": round(yaw, 4), "floor": floor,
                        "robot": is_robot, "class": self._classes.get(name) or "",
                    }
                )  # fmt: skip
        self._classes = {name: text for name, text in self._classes.items() if name in self.places}
        self._call_for(self._classes, self.places, _INFO, lambda name: GetEntityInfo.Request(entity=name), self._on_info)
        return rows

    def rooms(self, response: Any) -> list[dict[str, Any]]:
        """Returns the rooms for the page, sorted by floor and name: bounding box (low and high x and y, m) and floor.

        Args:
            response: response of GetNamedPoses.
        """
        poses = {pose.name: pose for pose in response.poses if _ROOM in pose.tags}
        if self._rooms.keys() - poses.keys():
            self._rooms = {}  # another world, whose rooms may have the same names
        self._call_for(
            self._rooms,
            poses,
            _BOUNDS,
            lambda name: GetNamedPoseBounds.Request(name=name),
            lambda name, answer: self._on_bounds(poses[name], answer),
        )
        known = [room for room in self._rooms.values() if room]
        return sorted(known, key=lambda room: (room["floor"], room["name"]))

    def _call_for(
        self,
        found: dict[str, Any],
        names: Collection[str],
        service: str,
        request: Callable[[str], Any],
        on_response: Callable[[str, Any], None],
    ) -> None:
        """Calls a service for the names of which nothing is known yet, a few at a time."""
        if not self._simulation.is_offered(service):
            return
        new = [name for name in names if name not in found]
        for name in new[: max(0, _AT_ONCE - sum(value is None for value in found.values()))]:
            found[name] = None
            self._simulation.begin(service, request(name), partial(on_response, name))

    def _on_info(self, name: str, response: Any) -> None:
        if response is not None and is_success(_INFO, response):
            self._classes[name] = response.info.description[:_MAX_TEXT]
        else:
            self._classes[name] = ""

    def _on_bounds(self, pose: Any, response: Any) -> None:
        points: list[Any] = list(response.bounds.points) if response is not None and is_success(_BOUNDS, response) else []
        p = pose.pose.position
        corners = [p.x, p.y, p.z] + [value for point in points for value in (point.x, point.y)]
        if len(points) != 2 or not all(map(math.isfinite, corners)):
            self._rooms[pose.name] = {}
            return
        self._rooms[pose.name] = {
            "name": pose.name.rpartition("/")[2],
            "floor": self._floor_at(p.z),
            "low": [p.x + min(point.x for point in points), p.y + min(point.y for point in points)],
            "high": [p.x + max(point.x for point in points), p.y + max(point.y for point in points)],
        }
