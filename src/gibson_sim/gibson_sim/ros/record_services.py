"""The services of a recorder, with the names and types of rosbag2's own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node

from gibson_sim.bags.recording import Recording

try:
    from rosbag2_interfaces.srv import IsPaused, Pause, Resume, Snapshot, SplitBagfile
except ImportError:
    IsPaused = None


def offer_services(node: Node, recording: Recording, take_waiting: Callable[[], None]) -> None:
    """Offers ~/pause, ~/resume, ~/is_paused and ~/split_bagfile, or ~/snapshot in place of the last; says where they are missing.

    Args:
        node: of the services.
        recording: what they rule.
        take_waiting: records what waits; called first, since it was sent before the request.
    """
    if IsPaused is None:
        node.get_logger().warning("no package rosbag2_interfaces here: ~/pause, ~/resume, ~/snapshot and their like are missing")
        return

    def on_pause(_: Any, response: Any) -> Any:
        take_waiting()
        recording.pause()
        return response

    def on_resume(_: Any, response: Any) -> Any:
        take_waiting()
        recording.resume()
        return response

    def on_is_paused(_: Any, response: Any) -> Any:
        response.paused = recording.paused
        return response

    def on_split(_: Any, response: Any) -> Any:
        take_waiting()
        recording.split()
        return response

    def on_snapshot(_: Any, response: Any) -> Any:
        take_waiting()
        response.success = recording.snapshot() is not None
        return response

    node.create_service(Pause, "~/pause", on_pause)
    node.create_service(Resume, "~/resume", on_resume)
    node.create_service(IsPaused, "~/is_paused", on_is_paused)
    if recording.keeps_snapshots:
        node.create_service(Snapshot, "~/snapshot", on_snapshot)
    else:
        node.create_service(SplitBagfile, "~/split_bagfile", on_split)
