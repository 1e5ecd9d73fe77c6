"""A running simulation: services, parameters and topics of a robot with an arm, with requests that make sense, and others.

It must answer each request quickly and with a reason, tell nothing of a file, and let time go on; no message may end it.
"""

from __future__ import annotations

import contextlib
import math
import random
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, GetParameters, SetParameters, SetParametersAtomically
from rclpy._rclpy_pybind11 import RCLError
from rclpy.serialization import serialize_message
from rosgraph_msgs.msg import Clock
from simulation_interfaces import msg as sim_msg, srv

from fuzz import seeds
from fuzz.grammar import SECRET, SECRET_NUMBER, Mutator
from fuzz.requests import change, command, fill_spawn
from gibson_sim.description.urdf import read_urdf
from support.clients import client_of
from support.scenes import write_room
from support.simulation import PATIENCE_S, Launched, Listener

ROBOT = "arm_bot"
OPTIONS = ("--robot", ROBOT, "--no-render")
LIMIT_MB = 1200.0
"""What the physics node may have in use."""
_TIDY_EVERY = 25
_READING = (
    "get_simulator_features", "get_simulation_state", "get_entities", "get_entities_states", "get_entity_state", "get_entity_info",
    "get_entity_bounds", "get_spawnables", "get_named_poses", "get_named_pose_bounds", "get_available_worlds", "get_current_world",
)  # fmt: skip
_CHANGING = (
    "spawn_entity", "spawn_entity", "spawn_entity", "spawn_entities", "set_entity_state", "set_entity_state", "set_entity_info", "delete_entity",
    "reset_simulation", "set_simulation_state", "step_simulation",
)  # fmt: skip
_WORLDS = ("load_world", "unload_world")
_WITHOUT_WORLDS = 0.7
"""This share of the requests leaves the world, in which the robot is."""


def service_type(name: str) -> Any:
    """Returns the type of a service of the standard."""
    return getattr(srv, "".join(word.capitalize() for word in name.split("_")))


@dataclass(slots=True)
class Report:
    """What came of all requests."""

    sent: Counter[str] = field(default_factory=Counter)
    fulfilled: Counter[str] = field(default_factory=Counter)
    """Requests that reached the simulation: answered with RESULT_OK, or obeyed."""
    slowest_s: float = 0.0
    slowest: str = ""
    peak_mb: float = 0.0
    faults: list[str] = field(default_factory=list)

    @property
    def share(self) -> float:
        """Which share of the requests was fulfilled."""
        return sum(self.fulfilled.values()) / max(1, sum(self.sent.values()))

    def lines(self) -> list[str]:
        """Returns it for people."""
        head = f"{sum(self.sent.values())} requests and messages, {self.share:.0%} fulfilled, slowest {self.slowest} {self.slowest_s:.2f} s, "
        head += f"most memory {self.peak_mb:.0f} MB"
        return [head, *(f"FAULT {fault}" for fault in self.faults), f"{len(self.faults)} faults"]


class ServiceFuzzer:
    """Sends requests to a simulation and judges what it answers."""

    def __init__(self, sim: Launched, listener: Listener, folder: Path, seed: int) -> None:
        """Takes a simulation that plays in ``write_room(folder / "room")`` with ``OPTIONS``, and a client."""
        self.sim, self.listener, self.folder, self.seed = sim, listener, folder, seed
        self.report = Report()
        self._services = client_of(self.listener)
        self._publishers: dict[str, Any] = {}
        self._clock = listener.collect(Clock, "/clock")
        self._pid = sim.node_pid("physics")
        self._lines_seen = 0
        self._joints = tuple(
            j.name for j in read_urdf(seeds.ROOT / "config/robots" / ROBOT / f"{ROBOT}.urdf").joints if j.kind != "fixed"
        )
        self._files = self._write_files()
        self._last = ""
        self._things: list[str] = []
        self._worlds = False

    def _write_files(self) -> list[str]:
        """Writes files to spawn and to load, good and bad ones, with secrets in them."""
        room, things = self.folder / "room", self.folder / "things"
        seeds.mesh_files(things)
        (things / "thing.urdf").write_text(seeds.THING)
        (things / "crate.sdf").write_text(f'<sdf version="1.7">{seeds.SDF_MODEL}</sdf>')
        (things / "bad.urdf").write_text(f'<robot name="{SECRET}"><link name="{SECRET}"/><link name="{SECRET}"/></robot>')
        (things / "bad.yaml").write_text(f"urdf: {SECRET}\n{SECRET}: {SECRET_NUMBER}\n")
        (things / "scene.yaml").write_text(f"objects: [{{mesh: {SECRET}.glb}}]\n")
        (self.folder / f"{SECRET}.txt").write_text(SECRET)
        names = (
            "thing.urdf",
            "crate.sdf",
            "a.glb",
            "a.obj",
            "a.stl",
            "a.ply",
            "a.dae",
            "bad.urdf",
            "bad.yaml",
            "scene.yaml",
            "wood.png",
            "",
        )
        return [str(room), *(str(things / name) for name in names), str(self.folder)]

    def run(self, count: int, until: float = math.inf) -> Report:
        """Sends so many requests and messages, then asks whether all is well."""
        for number in range(count):
            if time.monotonic() > until or self.report.faults[20:]:
                break
            rng = random.Random(f"services {self.seed} {number}")
            mutator = Mutator(rng, harsh=rng.random() < 0.4)
            self._worlds = number > _WITHOUT_WORLDS * count
            self._send(mutator, number)
            if number % _TIDY_EVERY == _TIDY_EVERY - 1:
                self.tidy()
            if self.sim.process.poll() is not None:
                self._fault(f"the simulation ended with {self.sim.process.poll()}")
                return self.report
        self.tidy()
        return self.report

    def _fault(self, text: str) -> None:
        self.report.faults.append(f"{text} (after {self._last})")

    def _send(self, mutator: Mutator, number: int) -> None:
        kind = mutator.rng.random()
        if kind < 0.3:
            self._publish(mutator, number)
        elif kind < 0.4:
            self._parameters(mutator, number)
        else:
            changing = (*_CHANGING, *(_WORLDS if self._worlds else ()))
            name = mutator.rng.choice(_READING if mutator.chance(0.4) else changing)
            request = self._request(mutator, name)
            for _ in range(mutator.times() if mutator.harsh or mutator.chance(0.3) else 0):
                change(mutator, self._files, request)
            if name == "set_simulation_state" and request.state.state == request.state.STATE_QUITTING:
                request.state.state = 2
            if name in ("step_simulation",):
                request.steps = min(request.steps, 200)
            self._ask(service_type(name), name, request, number)

    def _request(self, mutator: Mutator, name: str) -> Any:
        """Returns a request that makes sense."""
        request = service_type(name).Request()
        entities = ["robot", *self._things]
        if hasattr(request, "entity"):
            request.entity = mutator.rng.choice(entities if name != "delete_entity" else [*self._things, "nothing"])
        if name in ("spawn_entity", "spawn_entities"):
            items = [request] if name == "spawn_entity" else [sim_msg.SpawnEntity() for _ in range(mutator.rng.choice((0, 1, 3)))]
            for item in items:
                fill_spawn(mutator, self._files, item)
            if name == "spawn_entities":
                request.spawn_requests = items
        elif name == "set_entity_state":
            request.state.pose.position.x, request.state.pose.position.y = mutator.rng.uniform(-1, 1), mutator.rng.uniform(-1, 1)
            request.state.pose.position.z, request.state.pose.orientation.w = 0.3, 1.0
            request.state.twist.linear.x = mutator.rng.uniform(-1, 1)
        elif name == "set_entity_info":
            request.info.tags = ["a", "b"]
        elif name == "set_simulation_state":
            request.state.state = mutator.rng.choice((0, 1, 1, 2))
        elif name == "reset_simulation":
            request.scope = mutator.rng.choice((0, 1, 2, 4, 255))
        elif name == "step_simulation":
            request.steps = mutator.rng.choice((1, 10))
        elif name == "load_world":
            request.uri = mutator.rng.choice((self._files[0], self._files[0], *self._files, "arena"))
        elif name == "get_named_pose_bounds":
            request.name = mutator.rng.choice(("middle", "nothing"))
        elif name == "get_spawnables":
            request.sources = mutator.rng.sample(self._files, mutator.rng.choice((0, 0, 1, 2)))
        elif name == "get_available_worlds":
            request.additional_sources = mutator.rng.sample(self._files, mutator.rng.choice((0, 0, 1, 2)))
            request.continue_on_error = mutator.chance(0.5)
        return request

    def _ask(self, kind: Any, name: str, request: Any, number: int) -> Any:
        """Sends a request and judges its answer."""
        self._last = f"{name} {number}"
        self._services.discover(name, kind)
        cpu, wall = _cpu_s(self._pid), time.monotonic()
        future = self._services.send(name, request)
        self._spin(future.done, name)
        took = min(time.monotonic() - wall, _cpu_s(self._pid) - cpu)
        self.report.sent[name] += 1
        if not future.done():
            self._fault(f"{name}: no answer in {PATIENCE_S:.0f} s")
            return None
        response = future.result()
        self._judge(name, request, response, took)
        found = getattr(response, "entities", None)
        if found is not None:
            self._things = [entity for entity in found if entity != "robot"]
        elif getattr(response, "entity_name", ""):
            self._things.append(response.entity_name)
        return response

    def _judge(self, name: str, request: Any, response: Any, took: float) -> None:
        if took > self.report.slowest_s:
            self.report.slowest_s, self.report.slowest = took, name
        result = getattr(response, "result", None)
        text = getattr(result, "error_message", "") if result is not None else ""
        if result is None or not hasattr(result, "result") or result.result == result.RESULT_OK:
            self.report.fulfilled[name] += 1
        elif not text:
            self._fault(f"{name}: refused without a reason")
        if "internal error" in text or "\n" in text or len(text) > 1000:
            self._fault(f"{name}: answers {text[:300]!r}")
        told = text.replace(f"{SECRET}.txt", "")
        if any(secret in told and secret not in str(request) for secret in (SECRET, str(SECRET_NUMBER))):
            self._fault(f"{name}: tells what stands in a file: {text[:300]!r}")

    def _parameters(self, mutator: Mutator, number: int) -> None:
        """Sets, reads and describes parameters of the physics node."""
        name = mutator.rng.choice(("rate", "rate", "rate", "scene", "step_hz", "seed", "use_sim_time", "nothing", "a" * 1000, ""))
        value = ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=mutator.rng.choice((1.0, 1.0, 2.0, 0.5)))
        if mutator.harsh:
            value = mutator.rng.choice(
                (
                    ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=float(mutator.number(1.0))),
                    ParameterValue(type=ParameterType.PARAMETER_STRING, string_value="x" * 10**5),
                    ParameterValue(type=ParameterType.PARAMETER_INTEGER, integer_value=-(2**63)),
                    ParameterValue(type=ParameterType.PARAMETER_DOUBLE_ARRAY, double_array_value=[math.nan] * 1000),
                    ParameterValue(type=ParameterType.PARAMETER_NOT_SET),
                    ParameterValue(type=mutator.rng.choice((10, 77, 255))),
                )
            )
        entries = [Parameter(name=name, value=value)] * mutator.rng.choice((1, 1, 1, 0, 3))
        kind = mutator.rng.choice((SetParameters, SetParameters, SetParametersAtomically, GetParameters, DescribeParameters))
        request = (
            kind.Request(parameters=entries)
            if "parameters" in kind.Request.get_fields_and_field_types()
            else kind.Request(names=[name])
        )
        service = {
            SetParameters: "set_parameters",
            SetParametersAtomically: "set_parameters_atomically",
            GetParameters: "get_parameters",
        }
        self._ask(kind, f"physics/{service.get(kind, 'describe_parameters')}", request, number)

    def _publish(self, mutator: Mutator, number: int) -> None:
        """Publishes a command, now and then bytes that are none."""
        topic, message = command(mutator, self._joints)
        for _ in range(mutator.times() if mutator.chance(0.7) else 0):
            change(mutator, self._files, message)
        self._last = f"{topic} {number}"
        publisher = self._publishers.get(topic)
        if publisher is None:
            publisher = self._publishers[topic] = self.listener.node.create_publisher(type(message), topic, 10)
            self._spin(lambda: publisher.get_subscription_count() > 0, topic)
        raw = serialize_message(message)
        with contextlib.suppress(RCLError):  # the middleware sends not everything
            publisher.publish(mutator.data(raw) if mutator.harsh and mutator.chance(0.3) else raw)
        self.report.sent["messages"] += 1
        self.report.fulfilled["messages"] += 1
        self._spin(lambda: True, topic)

    def _spin(self, done: Any, what: str) -> None:
        deadline = time.monotonic() + PATIENCE_S
        self.listener._executor.spin_once(timeout_sec=0.0)
        while not done() and time.monotonic() < deadline and self.sim.process.poll() is None:
            self.listener._executor.spin_once(timeout_sec=0.02)

    def tidy(self) -> None:
        """Brings back a world that plays, and looks whether time goes on, what the log says, and what it takes."""
        if self.sim.process.poll() is not None:
            return
        last = self._last
        state = self._ask(srv.GetSimulationState, "get_simulation_state", srv.GetSimulationState.Request(), -1)
        world = self._ask(srv.GetCurrentWorld, "get_current_world", srv.GetCurrentWorld.Request(), -1)
        self._last = last
        if state is None or world is None:
            return
        if world.result.result != world.result.RESULT_OK or world.world.world_resource.uri != self._files[0]:
            request = srv.LoadWorld.Request()
            request.uri = self._files[0]
            loaded = self._ask(srv.LoadWorld, "load_world", request, -1)
            if loaded.result.result != loaded.result.RESULT_OK:
                self._fault(f"the room cannot be loaded any more: {loaded.result.error_message}")
        self._ask(srv.ResetSimulation, "reset_simulation", srv.ResetSimulation.Request(scope=0), -1)
        self._ask(
            SetParameters,
            "physics/set_parameters",
            SetParameters.Request(parameters=[Parameter(name="rate", value=ParameterValue(type=3, double_value=1.0))]),
            -1,
        )
        play = srv.SetSimulationState.Request()
        play.state.state = 1
        self._ask(srv.SetSimulationState, "set_simulation_state", play, -1)
        self._clock.clear()
        self._spin(lambda: len({(c.clock.sec, c.clock.nanosec) for c in self._clock}) >= 3, "/clock")
        if len({(c.clock.sec, c.clock.nanosec) for c in self._clock}) < 3:
            self._fault(f"/clock stands still: state {state.state.state}")
        used = _memory_mb(self._pid)
        self.report.peak_mb = max(self.report.peak_mb, used)
        if used > LIMIT_MB:
            self._fault(f"the physics node has {used:.0f} MB in use, at most {LIMIT_MB:.0f} MB are allowed")
        for line in self.sim.lines[self._lines_seen :]:
            if "Traceback" in line or "mistake of ours" in line:
                self._fault(f"the log says {line[:200]!r}")
        self._lines_seen = len(self.sim.lines)


def _cpu_s(pid: int) -> float:
    """Returns the CPU time of a process; 0 of one that is gone."""
    try:
        values = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(values[11]) + int(values[12])) / 100.0


def _memory_mb(pid: int) -> float:
    lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    return next((int(line.split()[1]) / 1024 for line in lines if line.startswith("VmRSS")), 0.0)


def start(folder: Path) -> Launched:
    """Starts the simulation that a ``ServiceFuzzer`` takes."""
    sim = Launched("run", "--scene", str(write_room(folder / "room")), *OPTIONS)
    sim.wait_for_line("is ready")
    return sim


__all__ = ["OPTIONS", "Report", "ServiceFuzzer", "start"]
