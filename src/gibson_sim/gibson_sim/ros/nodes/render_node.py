"""The render node: renders the cameras of a scene from the states that the physics node publishes."""

from __future__ import annotations

import json
import time
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from gibson_msgs.msg import Scene, SceneState
from gibson_sim.config import RenderConfig
from gibson_sim.description.omissions import grouped
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.filling.fillers import network_digests, uses_network
from gibson_sim.geometry.exposures import needs_previous
from gibson_sim.geometry.transforms import Mat4, invert
from gibson_sim.processes.job_folder import STATUS, note_in_job
from gibson_sim.quoting import quoted
from gibson_sim.render.context import open_context
from gibson_sim.render.readback.pixel_buffers import PendingFrames
from gibson_sim.render.renderer import Renderer
from gibson_sim.ros import conversions
from gibson_sim.ros.lockstep.digest_publisher import DigestPublisher
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant, is_in_lockstep, wait_for_subscribers
from gibson_sim.ros.nodes.node_main import run_node, spin_while, write_summary
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.render_stats import LoadingProgress, RenderStats
from gibson_sim.ros.nodes.renderer_factory import device_of, open_renderer
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.camera_messages import REGISTERED, CameraPublisher
from gibson_sim.ros.topics.discovery import wait_until_acknowledged
from gibson_sim.ros.topics.run_info import publish_run_info
from gibson_sim.scenes.asset_paths import with_local_files
from gibson_sim.scenes.spec import DrawnScene
from gibson_sim.sensors.frame_history import FrameHistory
from gibson_sim.standard.lockstep import CAMERAS
from gibson_sim.types import NS_PER_S, CameraSpec, Frame, SceneState as State

_LATE_CHECK_S = 0.25
"""Period of the checks for late subscribers, s of wall time."""
_LATE_AFTER_S = 1.0
"""Time without a new state after which the simulation counts as paused, s of wall time."""
_REVISION_TIMEOUT_S = 2.0
"""Time after which states of another revision than the scene's are logged, s of wall time: scene and states may arrive in any order."""


class RenderNode(Node):
    """Renders the newest state at which a camera with subscribers is due, and counts skipped states.

    Images without subscribers are neither rendered nor encoded. Several render nodes may share the cameras (``cameras``), each with its own
    node name: ``--ros-args -r __node:=render_2``. docs/images.md describes the topics.

    Parameters: the fields of ``gibson_sim.config.RenderConfig``, and ``qos_overrides.<topic>.publisher.*``.

    Subscribes:
        scene (gibson_msgs/Scene, latched): the scene to render; a new revision updates the loaded scene.
        scene_state (gibson_msgs/SceneState): poses, and the cameras that are due.

    Publishes, for each camera, with the stamp of the rendered state, in the frame ``<camera>_optical_frame``:
        <camera>/image_raw (sensor_msgs/Image rgb8), <camera>/camera_info (sensor_msgs/CameraInfo), <camera>/image_raw/compressed
        (sensor_msgs/CompressedImage, JPEG or PNG);
        <camera>/depth/image_raw (sensor_msgs/Image 32FC1, metres along the axis, from the centre of a fisheye or equirectangular
        camera, +inf = nothing), <camera>/depth/camera_info, <camera>/depth/image_raw/compressedDepth (sensor_msgs/CompressedImage),
        <camera>/depth/points (sensor_msgs/PointCloud2, organised, NaN = nothing);
        for cameras of ``register_depth``: <camera>/depth_registered/image_raw (32FC1) and camera_info, in the other camera's frame;
        if the camera has these outputs: <camera>/semantic/image_raw and <camera>/instance/image_raw (16UC1), with label names in
        <camera>/semantic/label_info and <camera>/instance/label_info (LabelInfo, latched), <camera>/normal/image_raw and
        <camera>/normal_world/image_raw (32FC3, optical frame and world frame, 0 = nothing), <camera>/position/image_raw (32FC3, world
        frame, metres, NaN = nothing), <camera>/flow/image_raw (32FC2, pixels right and down since the previous image, NaN =
        nothing), <camera>/hole/image_raw (8UC1: 0 = surface, 1 = nothing, 2 = back face, 3 = outside or sky), each with its camera_info.
        run_info (gibson_msgs/RunInfo, latched); tick_done (gibson_msgs/TickDone), for lockstep; with ``digests``: tick_digest
        (gibson_msgs/TickDigest), of images before depth noise.
        /diagnostics (diagnostic_msgs/DiagnosticArray): images per second, skipped and failed images, render time in ms; once a second.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Checks the EGL device. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            GraphicsUnavailableError: no EGL device is usable.
        """
        super().__init__("render", **kwargs)
        self._renderer: Renderer | None = None
        self._config = config_from_parameters(self, RenderConfig)
        # Fails now, not when the scene arrives.
        open_context(device_of(self._config), library=self._config.egl_library).close()
        self._scene: DrawnScene | None = None
        self._refused: dict[str, CameraSpec] = {}
        """Cameras of the scene without images, since their hole filling cannot be loaded, by name."""
        self._cameras: dict[int, CameraPublisher] = {}
        """Index in the scene -> publisher of the camera."""
        self._state_subscription: Any = None
        self._early: SceneState | None = None
        """The newest state that arrived before its scene."""
        self._mismatched_since = 0.0
        """Monotonic time at which states of another revision began to arrive, s; 0 = the revisions agree."""
        self._frame_history: FrameHistory | None = None
        self._stats = RenderStats()
        self._lockstep: LockstepParticipant | None = None
        self._failure: GibsonSimError | None = None
        self._latest: SceneState | None = None
        """The newest state that can be rendered."""
        self._latest_since = 0.0
        """Monotonic time of its arrival, s."""
        self._served: dict[str, frozenset[str]] = {}
        """Camera name -> kinds of messages whose subscribers have received one."""
        self._last_done: tuple[int, int] | None = None
        """Epoch and stamp of the last tick reported as done; None = no state has arrived."""
        self._digests = DigestPublisher(self) if self._config.digests else None
        self.create_subscription(Scene, names.SCENE, self._on_scene, qos.LATCHED)
        self._diagnostics_pub = qos.make_publisher(self, DiagnosticArray, names.DIAGNOSTICS, qos.STATE)
        self.create_timer(1.0, self._publish_diagnostics, clock=Clock(clock_type=ClockType.STEADY_TIME))
        self.create_timer(_LATE_CHECK_S, self._serve_late_subscribers, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_scene(self, msg: Scene) -> None:
        """Loads the scene, then subscribes to the state: the subscription shows that this node is ready to render."""
        try:
            scene, warnings = with_local_files(conversions.scene_from_msg(msg), self._config.asset_folders)
            self._load(scene, warnings)
        except GibsonSimError as error:
            if self._state_subscription is None:
                self._failure = error  # the node ends: time would wait for it
            else:
                self.get_logger().error(f"scene {quoted(msg.name)} is not drawn: {error}")
            return
        for camera in self._cameras.values():
            camera.publish_labels(scene, conversions.time_from_msg(msg.header.stamp))
        early = self._early
        if early is not None and early.revision <= scene.revision:  # a state of a later revision waits for its scene
            self._early = None
            if early.revision == scene.revision:
                self._process_states([early])

    def _load(self, scene: DrawnScene, warnings: Sequence[str]) -> None:
        """Loads a scene, or the changes of a loaded one, and updates the publishers of the cameras."""
        started = time.monotonic()
        progress, reloaded = LoadingProgress(self._report_loading, self.get_logger().info), True
        if self._renderer is None:
            self._renderer = open_renderer(scene, self._config, progress)
            self._frame_history = FrameHistory(self._renderer)
        else:
            reloaded = self._renderer.update(scene, progress=progress)
        for warning in grouped((*warnings, *self._renderer.warnings)):
            self.get_logger().warning(warning)
        assert self._frame_history is not None
        self._frame_history.forget()
        self._scene = scene
        self._update_cameras(scene)
        info = self._renderer.info
        if reloaded:
            self.get_logger().info(
                f"scene {scene.name}: {info['triangles']} triangles, {info['textures']} textures "
                f"in {time.monotonic() - started:.1f} s, on {info['renderer']}"
            )
        if self._state_subscription is None:
            self._warm_up(scene)
            if self._failure is not None:  # the node ends; without the subscription, time does not start
                return
            self._state_subscription = self.create_subscription(SceneState, names.SCENE_STATE, self._on_state, qos.STATE)
            self._lockstep = LockstepParticipant(self, after=CAMERAS)
            digests = network_digests(publisher.camera.fill for publisher in self._cameras.values())
            networks = {f"network {fill}": digest for fill, digest in digests.items()}
            self._run_info = publish_run_info(self, "render", self._config, 0, opengl=dict(info), **networks)

    def _report_loading(self, stage: str) -> None:
        note_in_job(STATUS.format(self.get_name()), json.dumps({"loading": stage}))

    def _warm_up(self, scene: DrawnScene) -> None:
        """Renders every camera once before time starts: the first image compiles loops and shaders, which takes seconds at the very first start."""
        assert self._renderer is not None
        self._report_loading("the first image")
        cameras = [publisher.camera for publisher in self._cameras.values()]
        try:
            self._renderer.render(State.still(scene.revision, scene.links), cameras)
        except ConfigError as error:  # a network that fills holes cannot be run
            self._failure = error
        except GibsonSimError as error:  # logged again when images have subscribers
            self.get_logger().warning(f"the first images cannot be drawn: {error}")

    def _update_cameras(self, scene: DrawnScene) -> None:
        """Creates the publishers of new cameras, keeps those of unchanged cameras, and destroys the others."""
        by_name = {camera.name: camera for camera in scene.cameras}
        self._refused = {name: camera for name, camera in self._refused.items() if by_name.get(name) == camera}
        requested, registrations = self._config.camera_names, self._config.registrations
        try:
            self._config.check_cameras(tuple(by_name))
        except ConfigError as error:
            # Later, a robot with the camera may be spawned; in the first scene, it is a user error.
            if self._state_subscription is None and by_name:
                self._failure = error
            self.get_logger().warning(str(error))
        old = {publisher.camera.name: publisher for publisher in self._cameras.values()}
        self._cameras = {}
        for index, camera in enumerate(scene.cameras):
            if requested and camera.name not in requested:
                continue
            target = by_name.get(registrations.get(camera.name, ""))
            existing = old.get(camera.name)
            if existing is not None and (existing.camera, existing.target) == (camera, target):
                self._cameras[index] = old.pop(camera.name)
                continue
            if not self._can_fill(camera, first=self._state_subscription is None):
                continue
            if existing is not None:
                old.pop(camera.name).close()
            self._cameras[index] = CameraPublisher(self, camera, self._config, target)
        for publisher in old.values():
            publisher.close()

    def _can_fill(self, camera: CameraSpec, *, first: bool) -> bool:
        """Loads the hole filling of a camera; returns False if that fails, which ends the node if it happens in the first scene."""
        assert self._renderer is not None
        if self._refused.get(camera.name) == camera:
            return False
        try:
            self._renderer.prepare([camera])
        except ConfigError as error:
            if first:
                self._failure = ConfigError(f"camera {quoted(camera.name)}: {error}")
                return False
            self._refused[camera.name] = camera
            self._stats.count_failed(camera)
            self.get_logger().warning(f"camera {camera.name}: no images: {error}")
            return False
        return True

    def _on_state(self, msg: SceneState) -> None:
        """Renders the newest queued state at which a camera with subscribers is due."""
        self._process_states([msg, *pop_queue(self._state_subscription)])

    def _process_states(self, states: Sequence[SceneState]) -> None:
        """Renders the newest suitable state of several, and reports the newest tick as done."""
        assert self._scene is not None
        if self._last_done is None:
            self._last_done = (-1, -1)
            if is_in_lockstep(self):  # otherwise time passes meanwhile, and images would be lost
                wait_for_subscribers(self)
        drawable = [state for state in states if state.revision == self._scene.revision]
        self._store_mismatched(states, bool(drawable))
        due = {i for state in drawable for i in state.due_cameras if i in self._cameras}
        subscribed = {i: self._cameras[i].subscribed_kinds() for i in due}
        newest = None
        for state in drawable:
            has_subscribers = any(subscribed.get(i) for i in state.due_cameras)
            if has_subscribers or (newest is None and any(i in due for i in state.due_cameras)):
                newest = state
        for i in due:
            if not subscribed[i]:
                self._stats.count_due(self._cameras[i].camera, 0, subscribed=False)
        if drawable:
            self._latest, self._latest_since = drawable[-1], time.monotonic()
        statistics = None
        if newest is not None and _tick_key(newest) != self._last_done:
            requested = {i: subscribed[i] for i in newest.due_cameras if i in due}
            statistics = self._draw(newest, requested)
            self._served.update({self._cameras[i].camera.name: kinds for i, kinds in requested.items()})
        tick = next((state for state in reversed(drawable) if state.due_cameras), None)
        if tick is not None and self._lockstep is not None:
            self._last_done = _tick_key(tick)
            self._lockstep.tick_done(tick.header.stamp)
        if statistics is not None:  # after the report, so that time does not wait for the statistics
            self._stats.add(*statistics)
        if self._stats.report_is_late:
            self._publish_diagnostics()

    def _serve_late_subscribers(self) -> None:
        """Renders the newest state for late subscribers while the simulation is paused.

        Cameras with flow or a shutter are skipped: their images would depend on the time of the subscription. In lockstep only due cameras
        are rendered, and none in runs with digests, so that published images depend on simulation time only.
        """
        state = self._latest
        if state is None or self._scene is None or state.revision != self._scene.revision or self._digests is not None:
            return
        if time.monotonic() - self._latest_since < _LATE_AFTER_S:
            return
        late: dict[int, frozenset[str]] = {}
        for i, publisher in self._cameras.items():
            kinds, name = publisher.subscribed_kinds(), publisher.camera.name
            served = self._served[name] = self._served.get(name, frozenset()) & kinds
            if not kinds - served or needs_previous(publisher.camera) or (is_in_lockstep(self) and i not in state.due_cameras):
                continue
            late[i] = kinds - served
        statistics = self._draw(state, late) if late else None
        for i, kinds in late.items():
            self._served[self._cameras[i].camera.name] |= kinds
        if statistics is not None:
            self._stats.add(*statistics)

    def _store_mismatched(self, states: Sequence[SceneState], has_drawable: bool) -> None:
        """Stores the newest state whose scene has not arrived; warns if the scene does not arrive in time."""
        assert self._scene is not None
        mismatched = [state for state in states if state.revision != self._scene.revision]
        early = next((state for state in reversed(mismatched) if state.due_cameras), None)
        if has_drawable or not mismatched:
            self._early, self._mismatched_since = early, 0.0
            return
        self._early = early or self._early
        self._mismatched_since = self._mismatched_since or time.monotonic()
        if time.monotonic() - self._mismatched_since > _REVISION_TIMEOUT_S:
            self.get_logger().warning(
                f"states are of scene revision {mismatched[-1].revision}, revision {self._scene.revision} is loaded; nothing is drawn "
                "until the scene of that revision arrives",
                throttle_duration_sec=5.0,
            )

    def _draw(
        self, msg: SceneState, subscribed: dict[int, frozenset[str]]
    ) -> tuple[int, int, int, list[Frame], list[str]] | None:
        """Renders and publishes the subscribed kinds of messages of cameras.

        Args:
            msg: state to render.
            subscribed: index of each camera -> kinds of messages to publish.

        Returns:
            The arguments of ``RenderStats.add``; None = no images.
        """
        assert self._scene is not None and self._frame_history is not None
        stamp_ns, started_ns = conversions.time_from_msg(msg.header.stamp), time.monotonic_ns()
        specs = {i: spec for i, kinds in subscribed.items() if (spec := self._cameras[i].to_draw(kinds)) is not None}
        moving = [self._cameras[i].camera for i in subscribed if needs_previous(self._cameras[i].camera)]
        frames: dict[int, Frame] = {}
        messages: list[str] = []
        try:
            if specs or moving:
                state = conversions.scene_state_from_msg(msg, self._scene.links)
                frames = self._render(state, specs)
                self._frame_history.note(state, moving)
                drawn_ns = time.monotonic_ns()
                messages = self._publish(frames, subscribed, state)
        except GibsonSimError as error:  # of the state, and so of all cameras
            frames = {}
            self._warn_of_failures(stamp_ns, {str(error): list(specs)})
        failed = specs.keys() - frames.keys()
        for i, kinds in subscribed.items():
            if kinds and i in msg.due_cameras:
                self._stats.count_due(self._cameras[i].camera, stamp_ns, subscribed=True)
                if i in failed:
                    self._stats.count_failed(self._cameras[i].camera)
            if kinds and i not in failed:
                self._cameras[i].publish_info(stamp_ns, kinds)
        if self._digests is not None:
            self._digests.publish(stamp_ns, msg.epoch, msg.epoch_step)
        return (started_ns, drawn_ns, time.monotonic_ns(), list(frames.values()), messages) if frames else None

    def _render(self, state: State, specs: Mapping[int, CameraSpec]) -> dict[int, Frame]:
        """Renders cameras; returns the frames by index, without those of cameras that failed, of which it warns."""
        assert self._frame_history is not None
        pending: list[tuple[list[int], PendingFrames]] = []
        frames: dict[int, Frame] = {}
        failures: dict[str, list[int]] = {}
        for group in _groups(specs):
            try:
                pending.append((group, self._frame_history.start(state, [specs[i] for i in group])))
            except GibsonSimError as error:
                failures.setdefault(str(error), []).extend(group)
        for group, started in pending:
            try:
                frames.update(zip(group, started.result(), strict=True))
            except GibsonSimError as error:
                failures.setdefault(str(error), []).extend(group)
        if failures:
            self._warn_of_failures(state.stamp_ns, failures)
        return {i: frames[i] for i in specs if i in frames}

    def _warn_of_failures(self, stamp_ns: int, failures: Mapping[str, Sequence[int]]) -> None:
        """Warns of images that could not be rendered: message of the error -> indices of the cameras."""
        texts = [f"{', '.join(self._cameras[i].camera.name for i in cameras)}: {error}" for error, cameras in failures.items()]
        self.get_logger().warning(f"no image at {stamp_ns / NS_PER_S:.3f} s of {'; of '.join(texts)}", throttle_duration_sec=1.0)

    def _publish(self, frames: dict[int, Frame], subscribed: dict[int, frozenset[str]], state: State) -> list[str]:
        """Publishes images; returns ``<camera>/<kind>`` of each message."""
        published: list[str] = []
        if self._digests is not None:
            self._add_digests(frames.values())
        for i, frame in frames.items():
            publisher = self._cameras[i]
            T_target_camera = self._registration(publisher, state, frame) if REGISTERED in subscribed[i] else None
            published += [f"{publisher.camera.name}/{kind}" for kind in publisher.publish(frame, subscribed[i], T_target_camera)]
        return published

    def _add_digests(self, frames: Iterable[Frame]) -> None:
        assert self._digests is not None
        for frame in frames:
            topics = names.camera_topics(frame.camera.name)
            for output in frame.camera.outputs:
                self._digests.add(topics[output], getattr(frame, output))

    def _registration(self, publisher: CameraPublisher, state: State, frame: Frame) -> Mat4 | None:
        """Returns T_target_camera from a frame's camera to the target of its depth registration; None = no registration."""
        if publisher.target is None or self._renderer is None:
            return None
        T: Mat4 = invert(self._renderer.camera_matrix(state, publisher.target)) @ frame.T_world_camera
        return T

    def spin(self) -> int:
        """Renders until the context ends; returns the exit code.

        Raises:
            ConfigError: the settings name a camera that the first scene does not have, or the hole filling of a camera cannot be loaded.
        """
        spin_while(self, lambda: self._failure is None)
        if self._failure is not None:
            raise self._failure
        self._end_last_tick()
        return 0

    def _end_last_tick(self) -> None:
        """Renders the states that were queued when the end was requested; waits until subscribers have acknowledged the images."""
        if self._state_subscription is not None and (states := list(pop_queue(self._state_subscription))):
            self._process_states(states)
        wait_until_acknowledged(*(publisher for camera in self._cameras.values() for publisher in camera.publishers))

    def _publish_diagnostics(self) -> None:
        if self._renderer is None:
            return
        values = self._stats.since_last_report()
        level, message = _rating(values, self._refused)
        note_in_job(STATUS.format(self.get_name()), json.dumps(values))
        status = DiagnosticStatus(
            level=level,
            name=f"gibson_sim: {self.get_fully_qualified_name().lstrip('/')}",
            message=message,
            hardware_id=self._renderer.info["renderer"],
            values=[KeyValue(key=k, value=f"{v:.2f}") for k, v in values.items()],
        )
        header = conversions.header_to_msg(self._stats.last_stamp_ns, "")
        self._diagnostics_pub.publish(DiagnosticArray(header=header, status=[status]))

    def summary(self) -> dict[str, Any]:
        """Returns the statistics since the first image."""
        info = self._renderer.info if self._renderer else {}
        return {**self._stats.summary(), "renderer": info.get("renderer", ""), "triangles": info.get("triangles", 0)}

    def close(self) -> None:
        """Writes the summary and frees the renderer."""
        if self._renderer is not None:
            write_summary(self._config.summary_path, self.summary())
            self._renderer.close()
            self._renderer = None


def _rating(values: Mapping[str, float], refused: Collection[str]) -> tuple[bytes, str]:
    """Returns level and message of the diagnostics for statistics since the last report, and the cameras without images."""
    if refused:
        return DiagnosticStatus.ERROR, f"no images of {', '.join(refused)}: see the warnings in the log"
    if values["failed"]:
        return DiagnosticStatus.ERROR, "images cannot be rendered: see the warnings in the log"
    if values["skipped"]:
        return DiagnosticStatus.WARN, "skips images"
    return DiagnosticStatus.OK, "draws every image" if values["images_per_s"] else "idle: no subscriber of its images"


def _groups(specs: Mapping[int, CameraSpec]) -> list[list[int]]:
    """Returns the cameras in groups to be rendered together: an error costs the images of its group, so each with a network is on its own."""
    alone = [[i] for i, camera in specs.items() if uses_network(camera.fill)]
    together = [i for i, camera in specs.items() if not uses_network(camera.fill)]
    return [together, *alone] if together else alone


def pop_queue(subscription: Any) -> Iterator[Any]:
    """Yields all messages in a subscription's queue; the executor would render them one by one."""
    with subscription.handle:
        while (message := subscription.handle.take_message(subscription.msg_type, subscription.raw)) is not None:
            yield message[0]


def _tick_key(state: SceneState) -> tuple[int, int]:
    """Returns the epoch and stamp (ns) of a state, which identify a state that is republished in lockstep."""
    return state.epoch, conversions.time_from_msg(state.header.stamp)


def main(args: list[str] | None = None) -> None:
    """Runs the render node."""
    run_node(RenderNode, args)


if __name__ == "__main__":
    main()
