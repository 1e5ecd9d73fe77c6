"""Renders a recorded run again from its recorded states, without physics and without DDS: ``gibson-sim render``.

It is a separate program with its settings as JSON: ``python -m gibson_sim.ros.recording.render_bag '{"bag": {...}, "render": {...}}'``.
Topics, types, QoS and stamps are those of the render node. It uses message types, but never calls ``rclpy.init``.
"""

from __future__ import annotations

import json
import logging
import sys
import time
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, cast

from rclpy.serialization import serialize_message
from rosbags.interfaces import Connection, ConnectionExtRosbag2, MessageDefinitionFormat

from gibson_sim import interrupts
from gibson_sim.bags.definitions import canonical_type
from gibson_sim.bags.metadata import TopicQos
from gibson_sim.bags.progress import Advance, no_progress, progress_bar
from gibson_sim.bags.reader import BagReader
from gibson_sim.bags.rerender import SCENE_TYPE, STATE_TYPE, CameraSchedule, scene_topics, state_period_ns, topics_to_copy
from gibson_sim.bags.tracers import Tracer, open_tracer
from gibson_sim.bags.writer import BagWriter, Compression
from gibson_sim.client_config import RenderBagConfig
from gibson_sim.config import RenderConfig
from gibson_sim.errors import ConfigError, GibsonSimError, RecordError, RenderError
from gibson_sim.geometry.transforms import Mat4, invert
from gibson_sim.interrupts import Interruptible
from gibson_sim.maps.floor_extent import extent_of_drawn
from gibson_sim.quoting import quoted
from gibson_sim.render.readback.pixel_buffers import PendingFrames
from gibson_sim.render.renderer import Renderer
from gibson_sim.resources import find_config
from gibson_sim.ros import conversions
from gibson_sim.ros.nodes.node_main import end_with_parent, keep_large_blocks
from gibson_sim.ros.nodes.renderer_factory import open_renderer
from gibson_sim.ros.recording.bag_queue import BagQueue, FrameItem, Item, RawItem
from gibson_sim.ros.topics import names, qos
from gibson_sim.ros.topics.camera_messages import REGISTERED, REGISTERED_INFO, CameraMessages
from gibson_sim.ros.topics.camera_transforms import TF_TYPE, CameraTransforms, ViewTransforms
from gibson_sim.ros.wire.exact_bytes import exact_bytes
from gibson_sim.ros.wire.message_types import type_name_of
from gibson_sim.scenes.asset_paths import with_local_files
from gibson_sim.scenes.builder import SceneBuilder
from gibson_sim.scenes.load_views import load_camera_file, read_views
from gibson_sim.scenes.randomise import Rules, load_rules, randomise
from gibson_sim.scenes.scene_yaml import read_scene_yaml
from gibson_sim.scenes.spec import DrawnScene, LightSpec
from gibson_sim.scenes.views import FloorExtent, View, Views
from gibson_sim.sensors.frame_history import FrameHistory
from gibson_sim.types import NS_PER_S, CameraSpec, SceneState

if TYPE_CHECKING:
    from gibson_sim.jobs.units import Context

logger = logging.getLogger(__name__)
_SEPARATOR = "=" * 80


def render_bag(job: RenderBagConfig, render: RenderConfig, advance: Advance = no_progress) -> Summary:
    """Renders the cameras of a recorded run into a new bag.

    Args:
        job: settings of the bags and the cameras.
        render: settings of the renderer.
        advance: called with the progress, 0 to 1.

    Raises:
        GibsonSimError: the bag has nothing to render, a setting is invalid, a file is missing, or the disk is full.
    """
    with BagReader(job.bag) as bag, _Rendering(bag, job, render, advance) as rendering:
        return rendering.run()


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of a rendered bag."""

    images: int
    """Number of images of all cameras; all outputs of a camera at one stamp count once."""
    outputs: int
    """Number of images of all outputs."""
    cameras: tuple[str, ...]
    run_s: float
    """Duration of the recorded run, s of simulation time."""
    wall_s: float
    """Wall time of rendering and writing, without loading the scene, s."""
    skipped_states: int
    """Number of states at which a camera was due, but whose scene is not in the bag."""

    def text(self) -> str:
        """Returns one line for the user."""
        speed = self.run_s / self.wall_s if self.wall_s else 0.0
        skipped = f", {self.skipped_states} states skipped: the bag lacks their scene" if self.skipped_states else ""
        return (
            f"{self.images} images ({self.outputs} pictures) of {', '.join(self.cameras)}: {self.run_s:.2f} s of the run in "
            f"{self.wall_s:.2f} s, {speed:.2f} times real time{skipped}"
        )


class _Rendering:
    """Renders one bag."""

    def __init__(self, bag: BagReader, job: RenderBagConfig, render: RenderConfig, advance: Advance) -> None:
        self._bag, self._job, self._render, self._advance = bag, job, render, advance
        self._renderer: Renderer | None = None
        self._frame_history: FrameHistory | None = None
        self._tracer: Tracer | None = None
        self._traced: DrawnScene | None = None
        """The scene that the tracer has loaded."""
        self._loaded: DrawnScene | None = None
        """The loaded scene as recorded."""
        self._drawn: DrawnScene | None = None
        """The loaded scene as rendered."""
        self._started = 0.0
        """Monotonic time at which rendering started, s."""
        self._topics = scene_topics(bag)
        begin_ns, end_ns = bag.span_ns
        self._begin_ns = begin_ns + round(job.begin * NS_PER_S)
        self._end_ns = min(end_ns, begin_ns + round(job.end * NS_PER_S)) if job.end else end_ns
        if self._begin_ns >= self._end_ns:
            raise ConfigError(
                f"setting 'begin' is {job.begin:g} s, but bag {bag.folder} is {(end_ns - begin_ns) / NS_PER_S:g} s long"
            )
        self._rules: Rules | None = load_rules(find_config(job.randomise, "randomisation")) if job.randomise else None
        self._lights = _load_lights(job.lights) if job.lights else None
        self._added_cameras: tuple[CameraSpec, ...] = ()
        """Cameras of the setting ``cameras``; they replace the recorded ones."""
        self._requested_views: tuple[View, ...] = read_views(job.views, job.wanted_view_size(), job.view_rate)
        self._views: dict[int, Views] = {}
        """Scene revision -> views of the scene."""
        self._floor: FloorExtent | None = None
        self._recorded: dict[int, DrawnScene] = {}
        """Scene revision -> newest scene with it so far, as recorded."""
        self._read_scenes()
        self._copied = topics_to_copy(bag.topics(), job.copy, self._topics)
        self._cameras = self._all_cameras()
        self._kinds = {name: self._kinds_of(messages) for name, messages in self._cameras.items()}
        """Camera -> kind of message -> topic."""
        self._transforms = CameraTransforms(bag, self._added_cameras, self._copied)
        self._view_transforms = ViewTransforms()
        self._schedule = CameraSchedule(state_period_ns(bag, self._topics.state), interpolate=job.interpolate)
        self._due_as_recorded = not (job.cameras or self._requested_views or job.rate or job.interpolate)
        self._pending: _UnwrittenFrames | None = None
        self._after_pending: list[Item] = []
        """Items to write after the pending frames."""
        self._images = self._outputs = self._skipped = 0
        if job.tracer:
            self._tracer = open_tracer(job.tracer, job.blender_python, job.samples)

    def _read_scenes(self) -> None:
        for _, _, msg in self._bag.messages([self._topics.scene]):
            self._recorded.setdefault(msg.revision, conversions.scene_from_msg(msg))
        if self._job.cameras:
            links = dict.fromkeys(link for scene in self._recorded.values() for link in scene.links)
            self._added_cameras, views = load_camera_file(Path(self._job.cameras), tuple(links))
            self._requested_views = (*views, *self._requested_views)
        for scene in self._recorded.values():
            self._find_views(scene)
        for name, reason in next(iter(self._views.values())).absent.items() if self._views else ():
            if all(name in views.absent for views in self._views.values()):
                raise ConfigError(reason)

    def _find_views(self, scene: DrawnScene) -> None:
        """Sets the views of a scene."""
        if self._requested_views:
            cameras = () if self._job.cameras else scene.cameras
            with_cameras = replace(scene, cameras=(*cameras, *self._added_cameras))
            # A drawn scene does not mark the robots among its bodies, but their links come first.
            first = next((link for link in scene.links if "/" in link), "")
            self._views[scene.revision] = Views(
                self._requested_views, with_cameras, first.partition("/")[0], lambda: self._floor_of(scene)
            )

    def _floor_of(self, scene: DrawnScene) -> FloorExtent:
        """Returns the extent of the floor, which is computed once."""
        if self._floor is None:
            self._floor = extent_of_drawn(with_local_files(scene, self._render.asset_folders)[0], self._first_height())
        return self._floor

    def _first_height(self) -> float | None:
        """Returns the height at which the first robot starts, world metres; None = no robot, or no state."""
        for _, _, msg in self._bag.messages([self._topics.state]):
            if msg.revision not in self._recorded:
                continue
            state = conversions.scene_state_from_msg(msg, self._recorded[msg.revision].links)
            row = next((row for row, link in enumerate(state.links) if "/" in link), None)
            return None if row is None else float(state.positions[row, 2])
        return None

    def _cameras_of(self, scene: DrawnScene) -> tuple[CameraSpec, ...]:
        """Returns the cameras to render in a scene: those whose link exists, and the views."""
        changes: dict[str, Any] = {}
        if self._job.rate:
            changes["rate_hz"] = self._job.rate
        if outputs := self._job.wanted_outputs():
            changes["outputs"] = outputs
        cameras = self._added_cameras or (() if self._job.cameras else scene.cameras)
        present = [camera for camera in cameras if camera.link in ("", *scene.links)]
        if scene.revision in self._views:
            present += self._views[scene.revision].cameras
        return tuple(replace(camera, **changes) for camera in present)

    def _all_cameras(self) -> dict[str, CameraMessages]:
        """Returns camera name -> ``CameraMessages`` of the camera."""
        cameras = {camera.name: camera for scene in self._recorded.values() for camera in self._cameras_of(scene)}
        if not cameras:
            raise ConfigError(f"bag {self._bag.folder} has no cameras; add some with --cameras")
        registrations = self._render.registrations
        for name in {*registrations, *registrations.values()} - set(cameras):
            raise ConfigError(f"setting 'register_depth' names camera {quoted(name)}; there are: {', '.join(cameras)}")
        return {
            name: CameraMessages(camera, self._render, cameras.get(registrations.get(name, "")))
            for name, camera in cameras.items()
        }

    def _kinds_of(self, messages: CameraMessages) -> dict[str, str]:
        """Returns kind of message -> topic of the messages that are written for a camera."""
        outputs = messages.camera.outputs
        kinds = {*outputs, *(f"{output}_info" for output in outputs), REGISTERED, REGISTERED_INFO}
        return {kind: self._topics.prefix + topic for kind, _, topic in messages.topics() if kind in kinds}

    def run(self) -> Summary:
        """Renders the bag from begin to end."""
        definitions = definitions_of(c for c in self._bag.connections if c.msgtype not in (SCENE_TYPE, STATE_TYPE))
        with BagWriter(
            self._job.output,
            message_definitions=definitions,
            reserve_bytes=self._job.reserve_mb * 1_000_000,
            compression=cast(Compression, self._job.compression),
        ) as bag:
            self._declare(bag)
            with BagQueue(bag) as queue:
                for topic, log_ns, data in self._messages():
                    self._process(queue, topic, log_ns, data)
                    self._advance((log_ns - self._begin_ns) / max(self._end_ns - self._begin_ns, 1))
                self._write_pending(queue)
        return Summary(
            self._images, self._outputs, tuple(self._cameras), (self._end_ns - self._begin_ns) / NS_PER_S,
            time.monotonic() - self._started if self._started else 0.0, self._skipped,
        )  # fmt: skip

    def _declare(self, bag: BagWriter) -> None:
        """Declares all topics of the new bag."""
        bag.add_topic(self._topics.scene, SCENE_TYPE, qos.LATCHED)
        bag.add_topic(self._topics.state, STATE_TYPE, qos.STATE)
        for connection in self._bag.connections:
            if connection.topic in self._copied:
                bag.add_topic(connection.topic, connection.msgtype, offered_qos(connection))
        if self._views and names.TF not in self._copied:
            bag.add_topic(names.TF, TF_TYPE, qos.TF)
        for name, messages in self._cameras.items():
            for kind, message_type, topic in messages.topics():
                if kind in self._kinds[name]:
                    bag.add_topic(self._topics.prefix + topic, type_name_of(message_type), qos.SENSOR)
            for _, message_type, topic in messages.label_topics():
                bag.add_topic(self._topics.prefix + topic, type_name_of(message_type), qos.LATCHED)

    def _messages(self) -> Iterator[tuple[str, int, bytes]]:
        """Yields topic, log time (ns) and data of the messages between begin and end, after the earlier latched ones, at the begin time."""
        topics = (self._topics.scene, self._topics.state, *self._copied)
        latched = [topic for topic, info in self._bag.topics().items() if info.latched and topic in topics]
        if self._job.begin and latched:
            for topic, _, data in self._bag.raw_messages(latched, stop_ns=self._begin_ns):
                yield topic, self._begin_ns, data
        yield from self._bag.raw_messages(topics, start_ns=self._begin_ns, stop_ns=self._end_ns + 1)

    def _process(self, queue: BagQueue, topic: str, log_ns: int, data: bytes) -> None:
        """Processes the next message of the recorded bag."""
        if topic == self._topics.scene:
            self._on_scene(queue, self._bag.decode(SCENE_TYPE, data), log_ns)
        elif topic == self._topics.state:
            self._on_state(queue, self._bag.decode(STATE_TYPE, data), log_ns)
        else:
            self._write(queue, [RawItem(topic, self._transforms.completed(topic, data), log_ns)])

    def _write(self, queue: BagQueue, items: list[Item]) -> None:
        """Writes items after the pending frames."""
        if self._pending is not None:
            self._after_pending += items
        else:
            queue.put(items)

    def _write_pending(self, queue: BagQueue) -> None:
        """Waits for the pending frames, and writes them and all items after them."""
        if self._pending is None:
            return
        frame_items: list[Item] = []
        pending, self._pending = self._pending, None
        for frame, messages, T_target_camera in zip(
            pending.frames.result(), pending.messages, pending.T_target_cameras, strict=True
        ):
            kinds = self._kinds[messages.camera.name]
            if self._tracer is not None and frame.rgb is not None:
                frame = replace(frame, rgb=self._tracer.colors(pending.state, frame))
            frame_items.append(FrameItem(messages, kinds, frame, T_target_camera, pending.log_ns))
            self._images += 1
            self._outputs += len(messages.camera.outputs)
        later_items, self._after_pending = self._after_pending, []
        queue.put([*frame_items, *later_items])

    def _on_scene(self, queue: BagQueue, msg: Any, log_ns: int) -> None:
        scene = self._recorded[msg.revision] = conversions.scene_from_msg(msg)
        self._find_views(scene)
        new_msg = conversions.scene_to_msg(self._with_settings(scene), conversions.time_from_msg(msg.header.stamp))
        self._write(queue, [RawItem(self._topics.scene, exact_bytes(new_msg), log_ns)])

    def _with_settings(self, scene: DrawnScene) -> DrawnScene:
        """Returns the scene with the requested cameras, lights and appearances."""
        links = self._views[scene.revision].scene.links if scene.revision in self._views else scene.links
        scene = replace(scene, links=links, cameras=self._cameras_of(scene), light=self._lights or scene.light)
        return scene if self._rules is None else randomise(scene, self._job.randomise_seed, self._rules)

    def _on_state(self, queue: BagQueue, msg: Any, log_ns: int) -> None:
        """Writes the state, or interpolated ones up to it, and renders the cameras that are due."""
        scene = self._recorded.get(msg.revision)
        if scene is None:
            self._skipped += bool(len(msg.due_cameras))
            return
        if scene != self._loaded:
            self._write_pending(queue)
            self._load(queue, scene, conversions.time_from_msg(msg.header.stamp), log_ns)
        assert self._drawn is not None
        state = conversions.scene_state_from_msg(msg, scene.links)
        recorded = tuple(msg.due_cameras.tolist()) if self._due_as_recorded else None
        views = self._views.get(msg.revision)
        for moment, due in self._schedule.moments(state, self._drawn.cameras, recorded):
            if views is not None:
                poses = views.poses(moment)
                moment = views.extended(moment, poses)
                self._write(
                    queue, [RawItem(names.TF, self._view_transforms.message(views.cameras, poses, moment.stamp_ns), log_ns)]
                )
            new_msg = conversions.scene_state_to_msg(moment, due, getattr(msg, "epoch", 0), getattr(msg, "epoch_step", 0))
            self._write(queue, [RawItem(self._topics.state, serialize_message(new_msg), log_ns)])
            if due:
                try:
                    self._draw(queue, moment, [self._drawn.cameras[k].name for k in due], log_ns)
                except (ConfigError, RenderError) as error:
                    seconds = (log_ns - self._bag.span_ns[0]) / NS_PER_S
                    raise RenderError(
                        f"{seconds:.3f} s after the start of the bag: {error}; {self._job.output} ends there"
                    ) from error

    def _load(self, queue: BagQueue, scene: DrawnScene, stamp_ns: int, log_ns: int) -> None:
        """Loads a scene, or the changes of a loaded one."""
        local, warnings = with_local_files(self._with_settings(scene), self._render.asset_folders)
        if self._renderer is None:
            self._renderer = open_renderer(local, self._render)
            self._frame_history = FrameHistory(self._renderer)
            self._started = time.monotonic()
        else:
            self._renderer.update(local)
        for warning in (*warnings, *self._renderer.warnings):
            logger.warning("%s", warning)
        if self._frame_history is not None:
            self._frame_history.forget()
        self._loaded, self._drawn = scene, local
        for camera in local.cameras:
            messages = self._cameras[camera.name]
            topics = {output: self._topics.prefix + topic for output, _, topic in messages.label_topics()}
            labels = [RawItem(topics[output], exact_bytes(label), log_ns) for output, label in messages.labels(local, stamp_ns)]
            self._write(queue, list(labels))

    def _draw(self, queue: BagQueue, state: SceneState, cameras: list[str], log_ns: int) -> None:
        """Starts to render cameras, then writes the previous frames."""
        assert self._frame_history is not None and self._renderer is not None
        messages = [self._cameras[name] for name in cameras]
        specs = [m.to_draw(frozenset(self._kinds[m.camera.name])) for m in messages]
        if self._tracer is not None and self._traced is not self._drawn:
            assert self._drawn is not None
            self._tracer.load(self._drawn, state, self._renderer.render)
            self._traced = self._drawn
        frames = self._frame_history.start(state, [spec for spec in specs if spec is not None])
        targets = [
            None if m.target is None else invert(self._renderer.camera_matrix(state, m.target)) @ self._renderer.camera_matrix(state, m.camera)
            for m in messages
        ]  # fmt: skip
        self._write_pending(queue)
        self._pending = _UnwrittenFrames(frames, state, messages, targets, log_ns)

    def __enter__(self) -> _Rendering:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        if self._tracer is not None:
            self._tracer.close()
        if self._renderer is not None:
            self._renderer.close()


@dataclass(frozen=True, slots=True, eq=False)
class _UnwrittenFrames:
    """Frames that are being rendered, and how they are written to the bag."""

    frames: PendingFrames
    state: SceneState
    messages: list[CameraMessages]
    """Messages of the camera of each frame."""
    T_target_cameras: list[Mat4 | None]
    log_ns: int


def definitions_of(connections: Iterable[Connection]) -> dict[str, str]:
    """Returns type name -> definition of each message type embedded in a bag, including nested types.

    Copied messages are serialized by these definitions, whichever versions are installed.
    """
    definitions: dict[str, str] = {}
    for connection in connections:
        if connection.msgdef.format != MessageDefinitionFormat.MSG:
            continue
        first, *nested = connection.msgdef.data.split(_SEPARATOR)
        definitions[canonical_type(connection.msgtype)] = first.strip() + "\n"
        for part in nested:
            head, _, text = part.strip().partition("\n")
            definitions[canonical_type(head.removeprefix("MSG:").strip())] = text.strip() + "\n"
    return definitions


def offered_qos(connection: Connection) -> TopicQos:
    """Returns the QoS with which a topic was recorded; policies that are not in the bag have their defaults."""
    profiles = connection.ext.offered_qos_profiles if isinstance(connection.ext, ConnectionExtRosbag2) else []
    return TopicQos.recorded(profiles[0]) if profiles else TopicQos()


def _load_lights(path: str) -> LightSpec:
    """Returns the lights of a file with a section ``light`` as in a scene.yaml."""
    file = Path(path)
    builder = SceneBuilder(file.stem, file.parent, description=file)
    read_scene_yaml(builder, file)
    return builder.light


def render_one(arguments: dict[str, Any], folder: Path, context: Context) -> str:
    """Renders one bag into the unit's folder; returns the summary as a line. A unit of work for ``jobs``: ``gibson-sim render`` of several bags.

    Args:
        arguments: ``bag`` and ``render``, the settings; ``files``, the names of the settings in ``bag`` that are files of the unit.
        folder: folder of the new bag.
        context: context of the unit.

    Raises:
        GibsonSimError: the bag cannot be rendered, or the unit is interrupted.
    """
    logging.addLevelName(logging.WARNING, "WARN")
    logging.basicConfig(stream=sys.stderr, level=logging.WARNING, format="%(levelname)s %(message)s")
    keep_large_blocks()
    values = arguments["bag"]
    local_paths = {name: str(context.path(values[name])) for name in arguments["files"]}

    def advance(_: float) -> None:
        if context.stop():
            raise KeyboardInterrupt

    job = RenderBagConfig(**{**values, **local_paths, "output": str(folder)})
    try:
        return render_bag(job, RenderConfig(**arguments["render"]), advance).text()
    except KeyboardInterrupt as error:
        raise RecordError("interrupted: the new bag contains all messages up to now") from error


def main(arguments: list[str] | None = None) -> None:
    """Renders a bag with the settings in the only argument, as JSON; on a user error, ends the process with 1 and one line on stderr."""
    logging.addLevelName(logging.WARNING, "WARN")
    logging.basicConfig(stream=sys.stderr, level=logging.INFO, format="%(levelname)s %(message)s")
    end_with_parent()
    keep_large_blocks()
    try:
        values = json.loads((arguments or sys.argv[1:])[0])
        job, render = RenderBagConfig(**values["bag"]), RenderConfig(**values["render"])
        with Interruptible(), progress_bar("drawing") as advance:
            summary = render_bag(job, render, advance)
    except GibsonSimError as error:
        print(f"gibson-sim: error: {error}", file=sys.stderr)
        sys.exit(1)
    except KeyboardInterrupt:
        print("interrupted: the new bag contains all messages up to now", file=sys.stderr)
        interrupts.die()
    print(f"{job.output}: {summary.text()}")


if __name__ == "__main__":
    main()
