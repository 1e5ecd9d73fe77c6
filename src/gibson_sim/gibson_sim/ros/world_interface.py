"""The topics of the world as a whole: what there is, where it all is, the map, the epochs."""

from __future__ import annotations

import logging

from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.publisher import Publisher

from gibson_msgs.msg import Epoch, Scene, SceneState
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.ros import conversions, names, qos
from gibson_sim.ros.fast_publish import FastSceneState
from gibson_sim.scenes.floor_map import scene_floor_map
from gibson_sim.scenes.randomise import Rules, randomise
from gibson_sim.scenes.spec import WORLD_FRAME, drawn_scene
from gibson_sim.sensors.schedule import is_due
from gibson_sim.types import CameraSpec, SceneState as State

logger = logging.getLogger(__name__)
_MAP_HEIGHT = 0.5
"""Metres above the floor up to which things count as obstacles, in a world without robots."""


class WorldInterface:
    """Publishes the scene and its states for renderers, the map, and resets.

    Publishes:
        scene (gibson_msgs/Scene, latched), scene_state (gibson_msgs/SceneState).
        map (nav_msgs/OccupancyGrid, latched): the floor that robots start on, made from collision shapes.
        simulation_epoch (gibson_msgs/Epoch, latched): how often the simulation was reset.
    """

    def __init__(self, node: Node, config: PhysicsConfig, rules: Rules | None) -> None:
        self._node, self._config, self._rules = node, config, rules
        self._scene_pub = node.create_publisher(Scene, names.SCENE, **qos.overridable(qos.LATCHED))
        self._state_pub = node.create_publisher(SceneState, names.SCENE_STATE, **qos.overridable(qos.STATE))
        self._epoch_pub = node.create_publisher(Epoch, names.EPOCH, **qos.overridable(qos.LATCHED))
        self._map_pub: Publisher | None = None
        self._map_withdrawn = config.map == "off"
        self._fast_state: FastSceneState | None = None
        self._laid_out = -1
        self.cameras: tuple[CameraSpec, ...] = ()
        """In the order that ``due_cameras`` counts."""

    def publish_scene(self, world: PhysicsWorld) -> None:
        """Publishes what there is; again after every change."""
        drawn = drawn_scene(world.scene, world.links)
        if self._rules is not None:
            drawn = randomise(drawn, self._config.randomise_seed, self._rules)
        self.cameras = drawn.cameras
        self._scene_pub.publish(conversions.scene_to_msg(drawn, world.stamp_ns))

    def publish_state(self, state: State, tick: int) -> None:
        """Publishes all poses, and which cameras are due at ``tick``, which counts at ``publish_hz``."""
        due = tuple(i for i, c in enumerate(self.cameras) if is_due(tick, c.rate_hz, self._config.publish_hz))
        if self._fast_state is None or self._laid_out != state.revision:
            self._fast_state, self._laid_out = FastSceneState(WORLD_FRAME, len(state.links)), state.revision
        self._state_pub.publish(self._fast_state.serialize(state, due))

    def publish_epoch(self, epoch: int, stamp_ns: int, scope: int, *, rewound: bool) -> None:
        """Says that the simulation was reset."""
        header = conversions.header_to_msg(stamp_ns, "")
        self._epoch_pub.publish(Epoch(header=header, epoch=epoch, scope=scope, time_rewound=rewound))

    def publish_map(self, world: PhysicsWorld) -> None:
        """Publishes the map of the world's floor, unless somebody else does."""
        if self._map_withdrawn or self._gives_way(own=0 if self._map_pub is None else 1):
            return
        scene = world.scene
        height = max((robot.height for robot in scene.robots), default=_MAP_HEIGHT)
        try:
            floor = scene_floor_map(scene, robot_height=height, resolution=self._config.map_resolution)
        except GibsonSimError as error:
            logger.warning("no map is published: %s", error)
            return
        if self._map_pub is None:
            self._map_pub = self._node.create_publisher(OccupancyGrid, names.MAP, **qos.overridable(qos.LATCHED))
        self._map_pub.publish(conversions.floor_map_to_msg(floor, scene.floor_z, world.stamp_ns, WORLD_FRAME))

    def give_way(self) -> None:
        """Takes the map back once another node publishes one: readers would get both, in any order."""
        if self._map_pub is not None and self._gives_way(own=1):
            self._node.destroy_publisher(self._map_pub)
            self._map_pub = None

    def _gives_way(self, own: int) -> bool:
        if self._config.map == "auto" and self._node.count_publishers(names.MAP) > own:
            self._map_withdrawn = True
            self._node.get_logger().info("another node publishes the map: ours is withdrawn (setting map = on keeps it)")
        return self._map_withdrawn
