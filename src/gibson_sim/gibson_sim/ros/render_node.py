"""The render node: draws the cameras of a scene from the states that the physics node publishes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from statistics import median
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import CameraInfo, Image

from gibson_msgs.msg import Scene, SceneState
from gibson_sim.config import RenderConfig
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.geometry.exposures import needs_previous
from gibson_sim.render.cache import default_folder
from gibson_sim.render.context import open_context
from gibson_sim.render.renderer import Renderer
from gibson_sim.ros import conversions, names, qos
from gibson_sim.ros.node_main import run_node, spin_forever, write_summary
from gibson_sim.ros.params import config_from_parameters
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.sensors.depth_noise import apply_depth_noise
from gibson_sim.sensors.schedule import images_due
from gibson_sim.types import NS_PER_S, CameraSpec, Frame, SceneState as State


class RenderNode(Node):
    """Draws the newest state at which a camera is due, and counts those it had to skip.

    Parameters: the fields of ``gibson_sim.config.RenderConfig``.

    Subscribes:
        scene (gibson_msgs/Scene, latched): what to draw; another revision replaces what is loaded.
        scene_state (gibson_msgs/SceneState): poses, and which cameras take an image.

    Publishes, for each camera, with the stamp of the state drawn, in the frame ``<camera>_optical_frame``:
        <camera>/image_raw (sensor_msgs/Image rgb8), <camera>/camera_info (sensor_msgs/CameraInfo),
        <camera>/depth/image_raw (sensor_msgs/Image 32FC1, metres along the axis, from the centre of a fisheye or equirectangular
        camera, +inf = nothing), <camera>/depth/camera_info;
        where the camera has these outputs: <camera>/semantic/image_raw and <camera>/instance/image_raw (16UC1, numbers into the
        scene's lists), <camera>/normal/image_raw and <camera>/normal_world/image_raw (32FC3, optical frame and world frame, 0 =
        nothing), <camera>/position/image_raw (32FC3, world frame, metres, NaN = nothing), <camera>/flow/image_raw (32FC2, pixels
        right and down since the previous image, NaN = nothing), each with its camera_info.
        /diagnostics (diagnostic_msgs/DiagnosticArray): images a second, skipped, milliseconds to draw; once a second.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Opens the device. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            GraphicsUnavailableError: nothing here can draw.
        """
        super().__init__("render", **kwargs)
        self._renderer: Renderer | None = None
        self._config = config_from_parameters(self, RenderConfig)
        open_context(
            self._device, library=self._config.egl_library
        ).close()  # fail now, with a clear message, not when the scene arrives
        self._scene: DrawnScene | None = None
        self._image_publishers: dict[str, Publisher] = {}
        self._state_subscription: Any = None
        self._previous: dict[str, State] = {}
        self._stats = _Stats()
        self.create_subscription(Scene, names.SCENE, self._on_scene, qos.LATCHED)
        self._diagnostics_pub = self.create_publisher(DiagnosticArray, names.DIAGNOSTICS, qos.STATE)
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))

    @property
    def _device(self) -> int | str | None:
        return self._config.egl_uuid or (None if self._config.egl_device < 0 else self._config.egl_device)

    @property
    def _cache_folder(self) -> Path | None:
        if self._config.cache == "none":
            return None
        return Path(self._config.cache) if self._config.cache else default_folder()

    def _on_scene(self, msg: Scene) -> None:
        """Loads the scene, then asks for states: a subscriber to the state is one that is ready to draw."""
        try:
            self._load(conversions.scene_from_msg(msg))
        except GibsonSimError as error:
            self.get_logger().error(f"scene {msg.name!r} is not drawn: {error}")

    def _load(self, scene: DrawnScene) -> None:
        wanted = [n for n in self._config.cameras.split(",") if n]
        unknown = set(wanted) - {c.name for c in scene.cameras}
        if unknown:
            known = ", ".join(c.name for c in scene.cameras) or "none"
            raise ConfigError(f"setting 'cameras' names {', '.join(sorted(unknown))}; cameras of scene {scene.name!r}: {known}")
        started = time.monotonic()
        if self._renderer is not None:
            self._renderer.close()
        self._renderer = Renderer(
            scene,
            device=self._device,
            library=self._config.egl_library,
            detail_px=self._config.detail_px,
            compress_textures=self._config.compress_textures,
            cache=self._cache_folder,
            progress=_Progress(self.get_logger().info),
        )
        self._previous = {}
        for warning in self._renderer.warnings:
            self.get_logger().warning(warning)
        self._scene = scene
        self._drawn = {i: c for i, c in enumerate(scene.cameras) if not wanted or c.name in wanted}
        for camera in self._drawn.values():
            for kind, topic in names.camera_topics(camera.name).items():
                if topic not in self._image_publishers and kind.removesuffix("_info") in camera.outputs:
                    msg_type = CameraInfo if kind.endswith("_info") else Image
                    self._image_publishers[topic] = self.create_publisher(msg_type, topic, qos.SENSOR)
        info = self._renderer.info
        self.get_logger().info(
            f"scene {scene.name}: {info['triangles']} triangles, {info['textures']} textures "
            f"in {time.monotonic() - started:.1f} s, on {info['renderer']}"
        )
        if self._state_subscription is None:
            self._state_subscription = self.create_subscription(SceneState, names.SCENE_STATE, self._on_state, qos.STATE)

    def _on_state(self, msg: SceneState) -> None:
        """Draws the newest of the states that wait, if a camera is due at it or was due since the last one drawn."""
        due = None
        for state in (msg, *take_waiting(self._state_subscription)):
            if any(i in self._drawn for i in state.due_cameras):
                due = state
        if due is not None:
            self._draw(due)

    def _draw(self, msg: SceneState) -> None:
        """Draws and publishes the cameras that are due."""
        assert self._renderer is not None
        assert self._scene is not None
        cameras = [self._drawn[i] for i in msg.due_cameras if i in self._drawn]
        started = time.monotonic_ns()
        try:
            frames = self._frames(conversions.scene_state_from_msg(msg, self._scene.links), cameras)
        except GibsonSimError as error:
            self.get_logger().warning(
                f"state at {conversions.time_from_msg(msg.header.stamp)} ns is not drawn: {error}", throttle_duration_sec=1.0
            )
            return
        drawn = time.monotonic_ns()
        for frame in frames:
            topics = names.camera_topics(frame.camera.name)
            for kind, out in conversions.frame_to_image_msgs(frame).items():
                self._image_publishers[topics[kind]].publish(out)
        self._stats.add(started, drawn, time.monotonic_ns(), frames)

    def _frames(self, state: State, cameras: list[CameraSpec]) -> list[Frame]:
        """Returns the images of cameras at a state, each with the motion since its own image before."""
        assert self._renderer is not None
        since: dict[int, tuple[State | None, list[CameraSpec]]] = {}
        for camera in cameras:
            previous = self._previous.get(camera.name) if needs_previous(camera) else None
            if previous is not None and (previous.stamp_ns >= state.stamp_ns or previous.revision != state.revision):
                previous = None  # time went back: what lies between the two is no motion
            since.setdefault(id(previous), (previous, []))[1].append(camera)
        frames = [frame for previous, alike in since.values() for frame in self._renderer.render(state, alike, previous)]
        self._previous.update({camera.name: state for camera in cameras if needs_previous(camera)})
        return [apply_depth_noise(frame, frame.camera.depth_noise) for frame in frames]

    def spin(self) -> int:
        """Draws until the context ends; returns the exit code."""
        return spin_forever(self)

    def _publish_diagnostics(self) -> None:
        values = self._stats.since_last_report()
        if values is None:
            return
        status = DiagnosticStatus(
            level=DiagnosticStatus.WARN if values["skipped"] else DiagnosticStatus.OK,
            name="gibson_sim: render",
            message="skips images" if values["skipped"] else "draws every image",
            values=[KeyValue(key=k, value=f"{v:.2f}") for k, v in values.items()],
        )
        header = conversions.header_to_msg(self._stats.last_stamp_ns, "")
        self._diagnostics_pub.publish(DiagnosticArray(header=header, status=[status]))

    def summary(self) -> dict[str, Any]:
        """Returns what was measured since the first image."""
        info = self._renderer.info if self._renderer else {}
        return {**self._stats.summary(), "renderer": info.get("renderer", ""), "triangles": info.get("triangles", 0)}

    def close(self) -> None:
        """Writes the summary and frees the renderer."""
        if self._renderer is not None:
            write_summary(self._config.summary_path, self.summary())
            self._renderer.close()
            self._renderer = None


def take_waiting(subscription: Any) -> Iterator[Any]:
    """Yields the messages that wait in a subscription's queue. The executor would hand out one, then draw, then the next."""
    with subscription.handle:
        while (taken := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield taken[0]


class _Progress:
    """Says how far the loading of a scene is, every two seconds."""

    def __init__(self, say: Callable[[str], Any]) -> None:
        self._say, self._last = say, time.monotonic()

    def __call__(self, what: str, part: float) -> None:
        now = time.monotonic()
        if now - self._last >= 2.0:
            self._last = now
            self._say(f"{what}: {100.0 * part:.0f} %")


class _Stats:
    """Counts images and how long they took, in wall time."""

    def __init__(self) -> None:
        self.skipped = 0
        self.last_stamp_ns = 0
        self._images: dict[str, int] = {}
        self._stamps: dict[str, int] = {}
        self._draw_ms: list[float] = []
        self._publish_ms: list[float] = []
        self._first: tuple[int, int] = (0, 0)
        self._last_ns = 0
        self._reported = (0, 0, 0)

    def add(self, started_ns: int, drawn_ns: int, published_ns: int, frames: list[Frame]) -> None:
        if not self._images:
            self._first = (published_ns, frames[0].stamp_ns)
        for frame in frames:
            name, stamp_ns = frame.camera.name, frame.stamp_ns
            if name in self._stamps and stamp_ns > self._stamps[name]:
                self.skipped += images_due(self._stamps[name], stamp_ns, frame.camera.rate_hz) - 1
            self._stamps[name] = stamp_ns
            self._images[name] = self._images.get(name, 0) + 1
        self._draw_ms.append((drawn_ns - started_ns) / 1e6)
        self._publish_ms.append((published_ns - drawn_ns) / 1e6)
        self._last_ns, self.last_stamp_ns = published_ns, frames[0].stamp_ns

    def since_last_report(self) -> dict[str, float] | None:
        """Returns figures since the last call, or None where nothing was drawn yet."""
        if not self._images:
            return None
        now, total = time.monotonic_ns(), sum(self._images.values())
        then, images, skipped = self._reported
        self._reported = (now, total, self.skipped)
        seconds = (now - then) / NS_PER_S
        return {"images_per_s": (total - images) / seconds, "skipped": self.skipped - skipped, "draw_ms": self._draw_ms[-1]}

    def summary(self) -> dict[str, Any]:
        wall_s = (self._last_ns - self._first[0]) / NS_PER_S
        sim_s = (self.last_stamp_ns - self._first[1]) / NS_PER_S
        return {
            "images": dict(self._images),
            "images_per_wall_s": {k: (n - 1) / wall_s if wall_s else 0.0 for k, n in self._images.items()},
            "images_per_simulated_s": {k: (n - 1) / sim_s if sim_s else 0.0 for k, n in self._images.items()},
            "skipped_images": self.skipped,
            "draw_ms_median": median(self._draw_ms) if self._draw_ms else 0.0,
            "publish_ms_median": median(self._publish_ms) if self._publish_ms else 0.0,
        }


def main(args: list[str] | None = None) -> None:
    """Runs the render node."""
    run_node(RenderNode, args)


if __name__ == "__main__":
    main()
