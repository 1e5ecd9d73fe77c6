"""What a running simulation simulates: its world and its robot, for nodes that plan in them."""

from __future__ import annotations

import logging
import time
from typing import Any

from rclpy.node import Node
from simulation_interfaces.srv import GetCurrentWorld

from gibson_msgs.msg import RunInfo
from gibson_sim.errors import GibsonSimError, TextError
from gibson_sim.reading import parse_yaml
from gibson_sim.ros.client.requests import OK
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.discovery import offered_service
from gibson_sim.scenes import worlds
from gibson_sim.scenes.spec import SceneSpec

logger = logging.getLogger(__name__)
DEFAULT_ROBOT = "gibson_bot"
"""Robot of a simulation that was started with several robots, or names none."""
_RETRY_S = 1.0
"""Time without a response after which the world is requested again, s of wall time."""


class SimulatedWorld:
    """Requests the world of a simulation once, and receives the name of its robot; the owner of the node spins it.

    Subscribes:
        run_info (gibson_msgs/RunInfo): the robot that the simulation was started with.

    Calls get_current_world (simulation_interfaces/GetCurrentWorld): the loaded world, which is another one after ``load_world``.
    """

    def __init__(self, node: Node) -> None:
        self._node = node
        self._robot = ""
        self._client: Any = None
        self._answer: Any = None
        self._requested_s = 0.0
        self._subscription = node.create_subscription(RunInfo, names.RUN_INFO, self._on_run_info, qos.RUN_INFO)

    def is_known(self) -> bool:
        """Returns whether the simulation has named its world and its robot; requests them."""
        if self._client is None and (name := offered_service(self._node, GetCurrentWorld)):
            self._client = self._node.create_client(GetCurrentWorld, name)
        # A response can be lost if the simulation has not discovered the client yet.
        is_due = self._answer is None or (not self._is_answered and time.monotonic() - self._requested_s > _RETRY_S)
        if is_due and self._client is not None and self._client.service_is_ready():
            self._answer, self._requested_s = self._client.call_async(GetCurrentWorld.Request()), time.monotonic()
        return bool(self._robot) and self._is_answered

    @property
    def _is_answered(self) -> bool:
        return self._answer is not None and bool(self._answer.done())

    @property
    def robot(self) -> str:
        """Name or path of the robot, once it is known."""
        return self._robot

    def load_scene(self) -> SceneSpec:
        """Returns the scene of the world, without robots, once it is known.

        Raises:
            GibsonSimError: no world is loaded, or its files cannot be read here.
        """
        response = self._answer.result()
        if response.result.result != OK:
            raise GibsonSimError(f"the simulation names no scene: {response.result.error_message}")
        resource = response.world.world_resource
        return worlds.load_world(resource.uri, resource.resource_string, ignore_missing=True)

    def _on_run_info(self, msg: RunInfo) -> None:
        if msg.kind != "physics":
            return
        try:
            settings = parse_yaml(msg.settings)
        except TextError as error:
            logger.warning("run_info of %s cannot be read: %s", msg.node, error)
            settings = {}
        robot = str(settings.get("robot", "")) if isinstance(settings, dict) else ""
        self._robot = DEFAULT_ROBOT if not robot or "=" in robot else robot
