"""Records of a trial: planned run, outcome and result; ``run_folder`` stores each as JSON in the folder of the run."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Any, Literal

from gibson_sim.trials.json_values import json_values, restored

PlanarPose = tuple[float, float, float]
"""x, y, yaw: map frame, metres and radians."""
REFUSED_GOAL = "did not accept the goal"
"""Suffix of ``Outcome.detail`` if the stack's action rejected the goal."""


@dataclass(frozen=True, slots=True)
class PlacedObject:
    """An object to spawn."""

    name: str
    object: str
    """Catalogue name or file, as for ``gibson-sim spawn``."""
    pose: PlanarPose
    z: float = 0.0
    """Height of its origin, metres."""


@dataclass(frozen=True, slots=True)
class Person:
    """A person who walks back and forth along a path."""

    name: str
    path: tuple[tuple[float, float], ...]
    """Waypoints, map frame, metres."""
    speed: float
    """m/s."""
    radius: float
    height: float
    """Metres."""


@dataclass(frozen=True, slots=True)
class RunSpec:
    """One planned run: all sampled values, so that the run can be repeated on any machine."""

    number: int
    scene: str
    robot: str
    """Name or file; a file in the run's folder if the robot is randomised."""
    seed: int
    """Seed of the simulation's noise and of all other sampling in the run."""
    start: PlanarPose
    goal: PlanarPose
    shortest: float
    """Length of the shortest path on the map, metres."""
    radius: float
    """Radius of the robot, metres."""
    initial_error: PlanarPose = (0.0, 0.0, 0.0)
    """Error of the initial pose estimate, in the robot's frame."""
    things: tuple[PlacedObject, ...] = ()
    """Spawned objects."""
    closed_doors: tuple[str, ...] = ()
    """Names of bodies whose doors are closed."""
    people: tuple[Person, ...] = ()
    physics: dict[str, Any] = field(default_factory=dict)
    """Settings of the physics node that differ from its defaults, without scene, robot, start and seed."""
    drawn: dict[str, float] = field(default_factory=dict)
    """Sampled values of this run, such as ``slip``, for the report."""
    files: dict[str, str] = field(default_factory=dict)
    """Text files of the run by path relative to its folder, such as ``robot/robot.yaml``."""


End = Literal[
    "reached",  # the stack reports it, or the robot stands at the goal
    "gave up",  # the stack reports a failure
    "time limit",  # simulation time
    "wall time limit",
    "never ready",
    "stack died",
    "stack silent",  # in lockstep it sent no answer in time
    "simulation failed",
    "interrupted",
]


PAUSE = "pause"
"""Service of the recorder that interrupts the bag."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """Outcome of a run."""

    end: End
    detail: str
    """One line: event, value, limit."""
    lockstep: bool
    """Whether time waited for the stack; otherwise the run was in real time and is not bit-exact when repeated with the stack."""
    goal_ns: int = -1
    """Stamp at which the goal was sent; -1 = never."""
    decided_ns: int = -1
    """Stamp at which the stack reported its end or the robot came to rest at the goal; the run continues until the robot stands still."""
    end_ns: int = -1
    """Stamp of the last tick."""
    exit_code: int | None = None
    """Exit code of the stack if it ended by itself; negative = the signal."""
    status: str = ""
    """Latest text on the status topic."""
    callers: dict[str, list[str]] = field(default_factory=dict)
    """Service, action or topic that changes the world or its time, or pauses the recording -> nodes outside the simulation that had a
    client or publisher of it."""
    time_calls: list[list[Any]] = field(default_factory=list)
    """Requests by which other nodes changed how time passes, as the trial node received them, also if the run ended before the recorder did:
    stamp (ns), step, name and CDR bytes (hexadecimal) of each."""
    refused_commands: int = 0
    """Number of rejected commands: not finite, or malformed."""
    start_up_s: float = 0.0
    """Wall time until simulation time began."""
    running_s: float = 0.0
    """Wall time during which simulation time advanced."""
    ending_s: float = 0.0
    """Wall time from the last tick until all processes had ended."""


@dataclass(frozen=True, slots=True)
class Verdict:
    """One check of a run."""

    name: str
    """Key in the scenario, such as ``reached`` or ``rates.scan``."""
    passed: bool
    text: str
    """One sentence with the value and the limit."""
    value: float | None = None
    limit: float | None = None


CauseKind = Literal[
    "foreign call",
    "simulation failed",
    "stack died",
    "never ready",
    "stack silent",
    "no plan",
    "no command",
    "gave up",
    "plan through obstacle",
    "localisation jumped",
    "localisation off",
    "command ignored",
    "blocked",
    "slipped",
    "collision",
    "bad command",
    "too slow",
    "verdict",
    "unknown",
]
"""Kinds of causes of a failed run."""


@dataclass(frozen=True, slots=True)
class Cause:
    """The earliest event that led to the failure of a run."""

    kind: CauseKind
    text: str
    """One sentence: what happened, where and when."""
    time: float | None = None
    """Simulation time after the goal was sent, seconds."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of a judged run."""

    run: RunSpec
    outcome: Outcome
    verdicts: tuple[Verdict, ...]
    measures: dict[str, float]
    """Measured values: ``time``, ``length``, ``path_ratio``, ``clearance``, ``goal_distance``, ``collisions``, ``rms_acceleration``,
    ``localisation_error``, ... SI units; unknown values are omitted."""
    digest: str
    """Digest of all messages that physics published, tick by tick: equal digests = bit-exact equal runs. Empty = the bag has none."""
    cause: Cause | None = None
    """None = the run passed."""

    @property
    def passed(self) -> bool:
        """Whether all verdicts passed."""
        return all(verdict.passed for verdict in self.verdicts)

    def to_json(self) -> dict[str, Any]:
        """Returns the result as JSON values, with ``passed`` and without the run's files, which are in its folder."""
        values: dict[str, Any] = json_values(replace(self, run=replace(self.run, files={})))
        return {"passed": self.passed, **values}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> RunResult:
        """Restores a result from the values that ``to_json`` returned; its run has no files, and measures that were not finite are omitted."""
        measures = {name: float(value) for name, value in values["measures"].items() if value is not None}
        return restored(cls, {**{name: value for name, value in values.items() if name != "passed"}, "measures": measures})
