"""Topics of the whole world: the scene, its states, the map, the epochs."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from nav_msgs.msg import OccupancyGrid
from rclpy.node import Node
from rclpy.publisher import Publisher
from tf2_msgs.msg import TFMessage

from gibson_msgs.msg import Epoch, Scene, SceneState
from gibson_sim.config import CameraSettings, PhysicsConfig
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.maps.floor_extent import extent_of_scene
from gibson_sim.maps.floor_map import scene_floor_map
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.camera_transforms import ViewTransforms
from gibson_sim.ros.wire.fast_publish import FastSceneState
from gibson_sim.scenes.load_views import read_views
from gibson_sim.scenes.randomise import Rules, randomise
from gibson_sim.scenes.spec import DrawnScene, SceneSpec, drawn_scene
from gibson_sim.scenes.views import FloorExtent, Views
from gibson_sim.sensors.schedule import is_due
from gibson_sim.types import WORLD_FRAME, CameraSpec, SceneState as State

logger = logging.getLogger(__name__)
_MAP_HEIGHT = 0.5
"""Height above the floor up to which objects count as obstacles in a world without robots, m."""


class WorldInterface:
    """Publishes the scene and its states for renderers, the map, and resets.

    Publishes:
        scene (gibson_msgs/Scene, latched), scene_state (gibson_msgs/SceneState).
        map (nav_msgs/OccupancyGrid, latched): the floor that robots start on, computed from collision shapes; in a scene with several floors
            also floor_0/map, floor_1/map and so on, from the lowest.
        simulation_epoch (gibson_msgs/Epoch, latched): number of resets of the simulation.
        /tf (tf2_msgs/TFMessage): poses of the views, if there are any, in the map frame, with the stamp of the state.
    """

    def __init__(self, node: Node, config: PhysicsConfig, rules: Rules | None) -> None:
        self._node, self._config, self._rules = node, config, rules
        self._scene_pub = node.create_publisher(Scene, names.SCENE, **qos.overridable(qos.LATCHED))
        self._state_pub = node.create_publisher(SceneState, names.SCENE_STATE, **qos.overridable(qos.STATE))
        self._epoch_pub = node.create_publisher(Epoch, names.EPOCH, **qos.overridable(qos.LATCHED))
        self._maps: dict[str, Publisher] = {}
        self._map: OccupancyGrid | None = None
        """The present world's message on ``map``, which is published unless it is withdrawn; None = there is none."""
        self._map_withdrawn = False
        self._state_layout: FastSceneState | None = None
        self._layout_revision = -1
        self._last_state = b""
        self._requested_views = read_views(config.cameras.views, config.cameras.size_of_views, config.cameras.view_rate)
        self._views: Views | None = None
        self._floor: tuple[tuple[str, float], FloorExtent] | None = None
        """Hash of a scene, and the extent of its floor, which is computed once."""
        self._tf_pub: Publisher | None = None
        self._transforms = ViewTransforms()
        self.cameras: tuple[CameraSpec, ...] = ()
        """All cameras of the scene; ``due_cameras`` of a state has indices into them."""

    def publish_scene(self, world: PhysicsWorld) -> None:
        """Publishes the scene; called after every change."""
        drawn = drawn_scene(world.scene, world.links)
        drawn = replace(drawn, cameras=with_camera_settings(drawn.cameras, self._config.cameras))
        if self._requested_views:
            robot = next((robot.name for robot in world.scene.robots), "")
            drawn = self._set_views(Views(self._requested_views, drawn, robot, lambda: self._floor_of(world.scene)))
        if self._rules is not None:
            drawn = randomise(drawn, self._config.world.randomise_seed, self._rules)
        self.cameras = drawn.cameras
        self._scene_pub.publish(conversions.scene_to_msg(drawn, world.stamp_ns))

    def due(self, tick: int) -> tuple[int, ...]:
        """Returns the indices of the ``cameras`` that are due at a tick, which counts at ``publish_hz``."""
        return tuple(i for i, c in enumerate(self.cameras) if is_due(tick, c.rate_hz, self._config.time.publish_hz))

    def publish_state(self, state: State, due: tuple[int, ...], epoch: int, epoch_step: int) -> None:
        """Publishes a state with the indices of the ``cameras`` that are due."""
        if self._views is not None:
            state = self._with_views(self._views, state)
        if self._state_layout is None or self._layout_revision != state.revision:
            self._state_layout, self._layout_revision = FastSceneState(WORLD_FRAME, len(state.links)), state.revision
        self._last_state = self._state_layout.serialize(state, due, epoch, epoch_step)
        self._state_pub.publish(self._last_state)

    def _set_views(self, views: Views) -> DrawnScene:
        """Sets the views of the scene; returns the scene with the views.

        Raises:
            ConfigError: a requested view does not exist in the first scene.
        """
        if views.absent and self._views is None:
            raise ConfigError(next(iter(views.absent.values())))
        reported = {} if self._views is None else self._views.absent
        for name in views.absent.keys() - reported.keys():
            logger.warning("%s", views.absent[name])
        if self._tf_pub is None:
            self._tf_pub = self._node.create_publisher(TFMessage, names.TF, **qos.overridable(qos.TF))
        self._views = views
        self._state_layout = None
        return views.scene

    def _with_views(self, views: Views, state: State) -> State:
        """Publishes the transforms of the views; returns the state with the views."""
        poses = views.poses(state)
        assert self._tf_pub is not None
        self._tf_pub.publish(self._transforms.message(views.cameras, poses, state.stamp_ns))
        return views.extended(state, poses)

    def _floor_of(self, scene: SceneSpec) -> FloorExtent:
        key = scene.content_hash, scene.floor_z
        if self._floor is None or self._floor[0] != key:
            self._floor = key, extent_of_scene(scene)
        return self._floor[1]

    def publish_state_again(self) -> None:
        """Republishes the last state, for a renderer that joined too late to receive it."""
        if self._last_state:
            self._state_pub.publish(self._last_state)

    def publish_epoch(self, epoch: int, stamp_ns: int, scope: int, *, rewound: bool) -> None:
        """Announces that the simulation was reset."""
        header = conversions.header_to_msg(stamp_ns, "")
        self._epoch_pub.publish(Epoch(header=header, epoch=epoch, scope=scope, time_rewound=rewound))

    def publish_map(self, world: PhysicsWorld) -> None:
        """Publishes the maps of the world's floors; publishes the topic ``map`` only while it has no other publisher."""
        self.withdraw_maps()
        if self._config.topics.map == "off":
            return
        scene = world.scene
        floors = {names.floor_map(i): z for i, z in enumerate(scene.floors)} if len(scene.floors) > 1 else {}
        floors[names.MAP] = scene.floor_z
        height = max((robot.height for robot in scene.robots), default=_MAP_HEIGHT)
        for topic, floor_z in floors.items():
            level = replace(scene, floor_z=floor_z)
            try:
                floor = scene_floor_map(level, robot_height=height, resolution=self._config.topics.map_resolution)
            except GibsonSimError as error:
                logger.warning("no map is published on %s: %s", topic, error)
                continue
            message = conversions.floor_map_to_msg(floor, floor_z, world.stamp_ns, WORLD_FRAME)
            if topic == names.MAP:
                self._map = message
                if self._has_other_publisher(own_count=0):
                    continue
            self._publish_on(topic, message)

    def update_map(self) -> None:
        """Withdraws ``map`` once another node publishes it: subscribers would receive both, in any order. Publishes it again once none does.

        In lockstep the map stays withdrawn, since the tick at which a publisher disappears is not repeatable.
        """
        if names.MAP in self._maps:
            if self._has_other_publisher(own_count=1):
                self._node.destroy_publisher(self._maps.pop(names.MAP))
        elif self._map_withdrawn and not self._config.sync.lockstep and not self._node.count_publishers(names.MAP):
            self._map_withdrawn = False
            if self._map is not None:
                self._publish_on(names.MAP, self._map)
                self._node.get_logger().info("no other node publishes the map any more: ours is published again")

    def _publish_on(self, topic: str, message: OccupancyGrid) -> None:
        self._maps[topic] = self._node.create_publisher(OccupancyGrid, topic, **qos.overridable(qos.LATCHED))
        self._maps[topic].publish(message)

    def withdraw_maps(self) -> None:
        """Destroys the publishers of all maps: a subscriber that comes later gets none."""
        self._map = None
        while self._maps:
            self._node.destroy_publisher(self._maps.popitem()[1])

    def _has_other_publisher(self, own_count: int) -> bool:
        """Returns whether another node publishes ``map``, or has done so; ``own_count`` is the number of publishers of this node."""
        if self._config.topics.map == "auto" and not self._map_withdrawn and self._node.count_publishers(names.MAP) > own_count:
            self._map_withdrawn = True
            self._node.get_logger().info("another node publishes the map: ours is withdrawn (setting map = on keeps it)")
        return self._map_withdrawn


def with_camera_settings(cameras: Sequence[CameraSpec], settings: CameraSettings) -> tuple[CameraSpec, ...]:
    """Returns the cameras with the rate, the outputs and the hole filling that the settings override for all cameras."""
    changes: dict[str, Any] = {}
    if settings.camera_rate:
        changes["rate_hz"] = settings.camera_rate
    if outputs := settings.outputs:
        changes["outputs"] = outputs
    if settings.camera_fill:
        changes["fill"], changes["fill_depth"] = settings.fill
    return tuple(_with_mask(replace(camera, **changes)) for camera in cameras)


def _with_mask(camera: CameraSpec) -> CameraSpec:
    """Returns the camera with the output ``hole``, if its depth is filled, to mark the filled pixels."""
    has_mask = not camera.fill_depth or "hole" in camera.outputs
    return camera if has_mask else replace(camera, outputs=(*camera.outputs, "hole"))
