"""The simulation of an agent: executes the agent's tools, one after the other, in one thread."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from gibson_sim.agents import tools
from gibson_sim.agents.folders import Folders
from gibson_sim.cli.launching import PAGE_VIEWS
from gibson_sim.config import robots_of
from gibson_sim.errors import ConfigError, GibsonSimError
from gibson_sim.processes.environment import node_environment
from gibson_sim.quoting import clipped, enumerated, quoted
from gibson_sim.resources import known_objects, list_robots, list_scenes, list_trials
from gibson_sim.settings import nearest
from gibson_sim.testing.headless_simulation import HeadlessSimulation, SimulationEndedError
from gibson_sim.testing.processes import NODE_VARIABLES, Program

if TYPE_CHECKING:
    from gibson_sim.ros.client.client import RobotPose
    from gibson_sim.ros.web.child_nodes import Recorder

_IMAGE_S = 2.0
"""Longest time until a camera sends an image, s of simulation time."""
_LOOKS, _LOOK_S, _ARRIVES_S = 5, 1 / 30, 0.5
"""Greatest number of steps that a look at a paused simulation takes, the length of each, s of simulation time, and the time in which an image
arrives after one, s of wall time."""
_RECORDER = "record"
"""Name of the recorder's node."""
_RECORDER_S = 30.0
"""Longest time for the recorder to begin or to end, s of wall time."""
_SETTLED_S = 1.0
"""Time until the simulation has discovered the subscriptions of a recorder that has joined, s of wall time."""
_POLL_S = 0.05
_TAIL_LINES, _MAX_TAIL = 5, 1200
"""Number of lines of a log that an error quotes, and their greatest length together, characters."""
_MAX_LISTED = 20
_MAX_YAML = 8000
"""Greatest length of a message as YAML, characters."""


@dataclass(frozen=True)
class Answer:
    """What a tool returns."""

    text: str
    png: bytes | None = None
    """A picture; None = none."""


class AgentSession:
    """Owns at most one simulation and one trial. All calls come from one thread that lives as long as the session: their processes end with it."""

    def __init__(self, folders: Folders, domains: str) -> None:
        """Starts nothing yet.

        Args:
            folders: folders with files that may be used.
            domains: range of ROS domains, see ``testing.processes.free_domains``.
        """
        self._folders, self._domains = folders, domains
        self._simulation: HeadlessSimulation | None = None
        self._ended = ""
        """Why the last simulation ended by itself; empty = it did not."""
        self._has_cameras = False
        self._recorder: Recorder | None = None
        self._recording: Path | None = None
        self._trial: _TrialRun | None = None
        self._methods: dict[str, Callable[[Any], Any]] = {name: getattr(self, f"_{name}") for name in tools.TOOLS}

    def call(self, name: str, given: Mapping[str, Any]) -> Answer:
        """Executes a tool.

        Args:
            name: name of the tool.
            given: arguments as JSON values.

        Raises:
            GibsonSimError: it failed; one line for the agent.
        """
        tool = tools.parse_call(name, given)
        try:
            try:
                found = self._methods[name](tool)
            finally:
                if self._simulation is not None and self._simulation.is_usable:
                    self._simulation.unsubscribe()  # a topic without subscribers costs nothing
        except SimulationEndedError as error:
            raise self._report_end(error) from error
        return found if isinstance(found, Answer) else Answer(json.dumps(found, ensure_ascii=False))

    def close(self) -> None:
        """Ends the recording, the simulation and the trial; a second call does nothing."""
        self._stop()
        if self._trial is not None:
            self._trial.stop()

    def _report_end(self, error: GibsonSimError) -> GibsonSimError:
        """Forgets a simulation that has ended by itself; returns the error for the agent, with the end of its log."""
        log = self._simulation.log if self._simulation is not None else ""
        self._stop()
        self._ended = f"{error}; {_tail(log)}"
        return GibsonSimError(f"{self._ended}; start_simulation starts another one")

    def _stop(self) -> None:
        simulation, self._simulation = self._simulation, None
        if self._recorder is not None:
            self._recorder.close()
            self._recorder = None
        if simulation is not None:
            simulation.close()

    def _running(self) -> HeadlessSimulation:
        if self._simulation is None:
            why = f" (the last one: {self._ended})" if self._ended else ""
            raise ConfigError(f"no simulation runs{why}: call start_simulation first")
        return self._simulation

    # The simulation

    def _start_simulation(self, tool: tools.StartSimulation) -> dict[str, Any]:
        if self._simulation is not None and not self._simulation.is_usable:
            self._stop()  # it has ended by itself
        if self._simulation is not None:
            raise ConfigError(
                f"a simulation of {self._simulation.settings.physics.world.scene} runs already: call stop_simulation first, or reset"
            )
        settings: dict[str, Any] = {"scene": self._folders.name_or_file(tool.scene, list_scenes(), "scene")}
        settings |= {"robot": self._robots(tool.robot), "start": tool.start, "seed": tool.seed, "cameras": tool.cameras}
        settings |= {"views": PAGE_VIEWS} if tool.cameras else {}
        begin = time.monotonic()
        try:
            self._simulation = HeadlessSimulation(
                domains=self._domains, lockstep=tool.time == "stepped", reach="local", **settings
            )
        except SimulationEndedError as error:
            raise GibsonSimError(str(error)) from error
        self._ended, self._has_cameras = "", tool.cameras
        return {
            "started_in_s": round(time.monotonic() - begin, 1),
            "scene": tool.scene,
            **self._state(),
            "cameras": sorted(self._cameras()) if tool.cameras else [],
            "join": f"nodes on this machine join with ROS_DOMAIN_ID={self._simulation.domain_id}",
        }

    def _robots(self, text: str) -> str:
        """Returns the setting ``robot`` with resolved files."""
        known = list_robots()
        resolved = ((name, self._folders.name_or_file(robot, known, "robot")) for name, robot in robots_of(text))
        return ",".join(f"{name}={robot}" if name else robot for name, robot in resolved)

    def _stop_simulation(self, tool: tools.StopSimulation) -> dict[str, Any]:
        simulation = self._running()
        scene, time_s = simulation.settings.physics.world.scene, round(simulation.time, 4)
        self._stop()
        return {"stopped": scene, "time_s": time_s}

    def _get_state(self, tool: tools.GetState) -> dict[str, Any]:
        found: dict[str, Any] = {"simulation": "none", "folders": self._folders.names}
        if self._simulation is not None:
            found |= {"simulation": "running", "scene": self._simulation.settings.physics.world.scene, **self._state()}
        elif self._ended:
            found["last_simulation"] = self._ended
        if self._recorder is not None:
            found["recording"] = self._recorder.page_values()
        if self._trial is not None:
            found["trial"] = self._trial.summary()
        return found

    def _state(self) -> dict[str, Any]:
        simulation = self._running()
        contacts = simulation.contacts
        return {
            "time_s": round(simulation.time, 4),
            "time": "stepped" if simulation.settings.lockstep else "real",
            "paused": simulation.is_paused,
            "robots": {robot: _pose(simulation.robot_pose(robot)) for robot in simulation.settings.robots},
            "collisions": len(contacts),
            "last_collisions": [str(contact) for contact in contacts[-5:]],
            "ros_domain_id": simulation.domain_id,
        }

    def _list_names(self, tool: tools.ListNames) -> dict[str, Any]:
        of_files: dict[str, Callable[[], Sequence[str]]] = {
            "scenes": list_scenes, "robots": list_robots, "objects": known_objects, "trials": list_trials,
        }  # fmt: skip
        if tool.kind in of_files:
            return {tool.kind: list(of_files[tool.kind]())}
        simulation = self._running()
        values: Any
        if tool.kind == "cameras":
            values = {camera: sorted(topics) for camera, topics in sorted(self._cameras().items())}
        elif tool.kind == "topics":
            values = dict(sorted(simulation.topics().items()))
        elif tool.kind == "doors":
            values = {name: round(opening, 2) for name, opening in simulation.doors().items()}
        else:
            values = {name: _pose(pose) for name, pose in simulation.places().items()}
        return {tool.kind: values}

    # What is seen

    def _get_entities(self, tool: tools.GetEntities) -> dict[str, Any]:
        simulation = self._running()
        robot = simulation.robot_pose()
        entities = {name: pose for name, pose in simulation.entities().items() if tool.contains in name}
        nearest_first = sorted(entities.items(), key=lambda item: item[1].distance_to(robot.x, robot.y))
        listed = {name: _pose(pose) for name, pose in nearest_first[: tool.most]}
        return {"entities": listed, "not_listed": len(entities) - len(listed)}

    def _cameras(self) -> dict[str, dict[str, str]]:
        """Returns camera -> output -> topic."""
        from gibson_sim.ros.topics.names import is_derived
        from gibson_sim.types import OUTPUTS

        cameras: dict[str, dict[str, str]] = {}
        for topic, kind in self._running().topics().items():
            if kind == "sensor_msgs/msg/Image" and topic.endswith("/image_raw") and not is_derived(topic):
                name = topic.removesuffix("/image_raw").lstrip("/")
                camera, _, output = name.rpartition("/")
                is_output = bool(camera) and output in OUTPUTS
                cameras.setdefault(camera if is_output else name, {})[output if is_output else "rgb"] = topic
        return cameras

    def _get_image(self, tool: tools.GetImage) -> Answer:
        from gibson_sim.agents.pictures import picture
        from gibson_sim.ros import conversions

        simulation = self._running()
        if not self._has_cameras:
            raise ConfigError("this simulation has no cameras: stop it, and start one with cameras true")
        cameras = self._cameras()
        if tool.camera not in cameras:
            hint = nearest(tool.camera, list(cameras))
            listed = enumerated(sorted(cameras), _MAX_LISTED)
            raise ConfigError(f"camera {quoted(tool.camera)} does not exist{f'; {hint}' if hint else ''}; known: {listed}")
        if tool.output not in cameras[tool.camera]:
            raise ConfigError(f"camera {tool.camera} has no {tool.output}, but: {', '.join(sorted(cameras[tool.camera]))}")
        topic = cameras[tool.camera][tool.output]
        simulation.subscribe(topic)
        begin_ns = round(simulation.time * 1e9)

        def newest() -> Sequence[Any]:
            return [msg for msg in simulation.messages(topic)[-1:] if conversions.time_from_msg(msg.header.stamp) >= begin_ns]

        for _ in range(_LOOKS if simulation.is_paused else 0):
            simulation.step(_LOOK_S)
            if _wait(lambda: bool(newest()), _ARRIVES_S):
                break
        if simulation.is_paused and not newest():
            raise GibsonSimError(
                f"no image arrived on {topic} while the simulation is paused: call pause with paused false first"
            )
        (message,) = simulation.wait_until(newest, _IMAGE_S, what=f"an image on {topic}")
        png, found = picture(conversions.array_from_image(message), tool.width)
        stamp_s = round(conversions.time_from_msg(message.header.stamp) / 1e9, 4)
        return Answer(json.dumps({"camera": tool.camera, "output": tool.output, "time_s": stamp_s, **found}), png)

    def _read_topic(self, tool: tools.ReadTopic) -> Answer:
        from gibson_sim.ros.tools.hints import check_name
        from gibson_sim.ros.tools.yaml_messages import yaml_text

        simulation = self._running()
        check_name("topic", tool.topic)
        simulation.subscribe(tool.topic)
        if not simulation.messages(tool.topic):
            _refuse_paused(simulation)
        text = yaml_text(simulation.latest(tool.topic, tool.seconds), inline=True)
        return Answer(text if len(text) <= _MAX_YAML else f"{text[:_MAX_YAML]}\n... ({len(text)} characters)")

    # What is done

    def _drive(self, tool: tools.Drive) -> dict[str, Any]:
        return self._moving(
            tool.robot,
            lambda simulation: simulation.drive(tool.linear, tool.angular, tool.seconds, robot=tool.robot, lateral=tool.lateral),
        )

    def _drive_to(self, tool: tools.DriveTo) -> dict[str, Any]:
        return self._moving(
            tool.robot,
            lambda simulation: simulation.drive_to(tool.x, tool.y, tool.within, timeout=tool.seconds, robot=tool.robot),
        )

    def _moving(self, robot: str, drive: Callable[[HeadlessSimulation], None]) -> dict[str, Any]:
        """Drives, and returns the poses before and after it, and its collisions."""
        simulation = self._running()
        before, collided = simulation.robot_pose(robot), len(simulation.contacts)
        _refuse_paused(simulation)
        drive(simulation)
        return {
            "from": _pose(before),
            "to": _pose(simulation.robot_pose(robot)),
            "collisions": [str(contact) for contact in simulation.contacts[collided:][:_MAX_LISTED]],
            "time_s": round(simulation.time, 4),
        }

    def _step(self, tool: tools.Step) -> dict[str, Any]:
        self._running().step(tool.seconds)
        return self._state()

    def _pause(self, tool: tools.Pause) -> dict[str, Any]:
        simulation = self._running()
        if tool.paused:
            simulation.pause()
        else:
            simulation.play()
        return self._state()

    def _reset(self, tool: tools.Reset) -> dict[str, Any]:
        self._running().reset()
        return self._state()

    def _spawn(self, tool: tools.Spawn) -> dict[str, Any]:
        simulation = self._running()
        model = self._folders.name_or_file(tool.model, [*known_objects(), *list_robots()], "model")
        name = simulation.spawn(model, (tool.x, tool.y, tool.yaw), tool.name)
        return {"spawned": name, "at": _pose(simulation.entities()[name])}

    def _move(self, tool: tools.Move) -> dict[str, Any]:
        simulation = self._running()
        simulation.move(tool.name, (tool.x, tool.y, tool.yaw))
        return {"moved": tool.name, "at": _pose(simulation.entities()[tool.name])}

    def _delete(self, tool: tools.Delete) -> dict[str, Any]:
        self._running().delete(tool.name)
        return {"deleted": tool.name}

    def _open_door(self, tool: tools.OpenDoor) -> dict[str, Any]:
        simulation = self._running()
        _refuse_paused(simulation)
        simulation.open_door(tool.door, tool.opening)
        return {"door": tool.door, "opening": round(simulation.doors()[tool.door], 3), "time_s": round(simulation.time, 4)}

    # Recordings

    def _start_recording(self, tool: tools.StartRecording) -> dict[str, Any]:
        from gibson_sim.ros.web.child_nodes import Recorder

        simulation = self._running()
        if self._recorder is not None:
            raise ConfigError(f"a recording into {self._recording} runs already: call stop_recording first")
        folder = self._folders.new_folder(tool.folder, "recordings")
        recorder = Recorder(simulation.environment)
        recorder.start(images=tool.images, folder=folder)
        _wait(lambda: simulation.has_joined(_RECORDER) or not recorder.page_values()["on"], _RECORDER_S)
        if not simulation.has_joined(_RECORDER):
            error = recorder.page_values()["error"]
            recorder.close()
            raise GibsonSimError(f"nothing is recorded: {error or 'the recorder does not begin'}")
        time.sleep(_SETTLED_S)
        self._recorder, self._recording = recorder, folder
        return {"recording": str(folder)}

    def _stop_recording(self, tool: tools.StopRecording) -> dict[str, Any]:
        self._running()
        recorder, self._recorder = self._recorder, None
        if recorder is None:
            raise ConfigError("no recording runs: call start_recording first")
        recorder.stop()
        _wait(lambda: not recorder.page_values()["on"], _RECORDER_S)
        recorder.close()
        values = recorder.page_values()
        if values["error"]:
            raise GibsonSimError(f"the recording in {values['folder']} is incomplete: {values['error']}")
        return {"recorded": values["folder"], "bytes": values["bytes"], "look": f"gibson-sim bag check {values['folder']}"}

    # Trials

    def _run_trial(self, tool: tools.RunTrial) -> dict[str, Any]:
        if self._trial is not None and self._trial.is_running:
            raise ConfigError(f"the trial in {self._trial.folder} runs already: call get_trial with stop true first, or wait")
        file = self._folders.name_or_file(tool.file, list_trials(), "trial")
        self._trial = _TrialRun(file, self._folders.new_folder(tool.folder, "trials"), tool.runs)
        return self._trial.wait(tool.wait)

    def _get_trial(self, tool: tools.GetTrial) -> dict[str, Any]:
        if self._trial is None:
            raise ConfigError("no trial was started: call run_trial first")
        if tool.stop:
            self._trial.stop()
        return self._trial.wait(tool.wait)


class _TrialRun:
    """``gibson-sim trial`` in a process of its own."""

    def __init__(self, file: str, folder: Path, runs: int) -> None:
        """Starts the trial.

        Args:
            file: scenario file, or the name of a built-in one.
            folder: new folder for its results.
            runs: number of runs in each scene with each robot; 0 = as in the file.
        """
        self.folder = folder
        words = ["trial", file, "--output", str(folder), *(["--runs", str(runs)] if runs else [])]
        environment = {name: text for name, text in node_environment(reach="local").items() if name not in NODE_VARIABLES}
        command = [sys.executable, "-m", "gibson_sim.cli.main", *words]
        self._program = Program(command, environment, Path.cwd(), may_fail=True)

    @property
    def is_running(self) -> bool:
        """Whether it has not ended."""
        return self._program.returncode is None

    def wait(self, seconds: float) -> dict[str, Any]:
        """Waits for its end for at most some wall time, and returns its status.

        Raises:
            GibsonSimError: it failed without results.
        """
        _wait(lambda: not self.is_running, seconds)
        return self.status()

    def stop(self) -> None:
        """Stops it; the results so far are kept."""
        self._program.stop()

    def summary(self) -> dict[str, Any]:
        """Returns its status, or why it failed."""
        try:
            return self.status()
        except GibsonSimError as error:
            return {"trial": "failed", "error": str(error)}

    def status(self) -> dict[str, Any]:
        """Returns its verdict, or its progress.

        Raises:
            GibsonSimError: it failed without results.
        """
        from gibson_sim.trials.report.results import read_results
        from gibson_sim.trials.report.words import run_line
        from gibson_sim.trials.run_folder import RESULTS

        if self.is_running:
            finished = len(list(self.folder.glob("runs/*/result.json")))
            return {"trial": "running", "finished_runs": finished, "folder": str(self.folder), "log": _tail(self._program.output)}
        if not (self.folder / RESULTS).exists():
            raise GibsonSimError(f"the trial has no results: {_tail(self._program.output)}")
        results = read_results(self.folder)
        return {
            "trial": "finished" if results.is_complete else "stopped",
            "verdict": "passed" if results.is_complete and not results.failed else "failed" if results.failed else "incomplete",
            "rate": results.rate.text(),
            "causes": results.causes(),
            "failed_runs": [run_line(result) for result in results.failed[:_MAX_LISTED]],
            "page": str(self.folder / "index.html"),
            "results": str(self.folder / RESULTS),
        }


def _refuse_paused(simulation: HeadlessSimulation) -> None:
    if simulation.is_paused:
        raise ConfigError("the simulation is paused, so time does not pass: call pause with paused false first")


def _pose(pose: RobotPose) -> dict[str, float]:
    return {name: round(getattr(pose, name), 4) for name in ("x", "y", "z", "yaw")}


def _tail(log: str) -> str:
    lines = [line.strip() for line in log.splitlines() if line.strip()][-_TAIL_LINES:]
    return clipped(f"the end of its log: {' | '.join(lines)}" if lines else "its log is empty", _MAX_TAIL)


def _wait(condition: Callable[[], bool], seconds: float) -> bool:
    """Waits until a condition holds; returns False if it does not within some wall time."""
    deadline = time.monotonic() + seconds
    while not condition():
        if time.monotonic() >= deadline:
            return False
        time.sleep(_POLL_S)
    return True
