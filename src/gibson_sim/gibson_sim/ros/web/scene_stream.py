"""The scene for the 3-D view: its model, once per revision, and its poses, while a page shows it."""

from __future__ import annotations

import threading
import time
from typing import Any

from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from gibson_msgs.msg import Scene, SceneState
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros import conversions
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.web.video_subscriptions import Subscriber
from gibson_sim.scenes.asset_paths import with_local_files
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.types import NS_PER_S
from gibson_sim.web.scene_model import poses_message, scene_model
from gibson_sim.web.server import PageServer
from gibson_sim.web.videos import Poses

_NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
_PERIOD_S = 0.04
"""Minimum period of poses sent to pages, s of wall time."""


class SceneStream:
    """Subscribes to ``scene`` while a page shows the scene in 3-D, and always to ``scene_state``, which is deserialized only then.

    While time is paused, no state is published: a page that is opened then gets the last one.

    Args:
        node: node of the subscriptions.
        server: server that gets the model, as blobs ``scene``, ``scene_arrays`` and ``texture_<k>``, and the poses.
    """

    def __init__(self, node: Subscriber, server: PageServer) -> None:
        self._node, self._server = node, server
        self._subscription: Any = None
        self._last = b""
        """The newest state, serialized."""
        self._revision, self._links = -1, tuple[str, ...]()
        self._model_key: tuple[str, int] | None = None
        """Hash and revision of the scene of the newest model."""
        self._next_s = 0.0
        node.subscribe(SceneState, names.SCENE_STATE, self._on_state, _NEWEST, raw=True)

    def update(self, shown: bool) -> None:
        """Subscribes to the scene if a page shows it, otherwise unsubscribes."""
        if shown and self._subscription is None:
            self._subscription = self._node.subscribe(Scene, names.SCENE, self._on_scene, qos.LATCHED)
        elif not shown and self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _on_scene(self, msg: Scene) -> None:
        try:
            scene, _ = with_local_files(conversions.scene_from_msg(msg))
        except GibsonSimError as error:
            self._node.get_logger().warning(f"the scene is not shown in 3-D: {error}")
            return
        self._revision, self._links = scene.revision, scene.links
        if self._model_key != (scene.content_hash, scene.revision):
            self._model_key = (scene.content_hash, scene.revision)
            threading.Thread(target=self._build_model, args=(scene,), name="scene-model", daemon=True).start()
        self._show_state()

    def _build_model(self, scene: DrawnScene) -> None:
        """Builds the model, in a separate thread: it takes a second for a home, several for a large scan."""
        try:
            model = scene_model(scene, self._node.get_logger().warning)
        except GibsonSimError as error:
            self._node.get_logger().warning(f"the scene is not shown in 3-D: {error}")
            return
        if self._model_key != (scene.content_hash, scene.revision):
            return  # a newer model is being built
        self._server.serve_blob("scene", model.description)
        self._server.serve_blob("scene_arrays", model.arrays)
        for number, texture in enumerate(model.textures):
            self._server.serve_blob(f"texture_{number}", texture)
        self._server.broadcast("scene", {"version": f"{scene.content_hash[:12]}-{scene.revision}"}, keep=True)

    def _on_state(self, data: bytes) -> None:
        self._last = data
        now = time.monotonic()
        if self._subscription is not None and now >= self._next_s:
            self._next_s = now + _PERIOD_S
            self._show_state()

    def _show_state(self) -> None:
        """Sends the newest state to pages, if it belongs to the scene that they have."""
        msg = deserialize_message(self._last, SceneState) if self._last else None
        if msg is not None and msg.revision == self._revision:
            state = conversions.scene_state_from_msg(msg, self._links)
            self._server.send_image(Poses(poses_message(state), state.stamp_ns / NS_PER_S))
