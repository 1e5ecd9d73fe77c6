"""What passes between the parts of a trial: a planned run, how it ended, and its result. All are JSON in the folder of the run.

::

    OUT/results.json            the whole trial: scenario, all results
    OUT/runs/0007/run.json      RunSpec
    OUT/runs/0007/outcome.json  Outcome
    OUT/runs/0007/result.json   RunResult
    OUT/runs/0007/bag/          rosbag2, with /inputs, /run_info and /tick_digest, so that it can be replayed to the bit
    OUT/runs/0007/stack.log, simulation.log
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal

PlanarPose = tuple[float, float, float]
"""x, y, yaw: map frame, metres and radians."""
REFUSED_GOAL = "did not accept the goal"
"""End of the detail of an outcome of a stack whose action refused the goal."""


@dataclass(frozen=True, slots=True)
class PlacedThing:
    """A thing to spawn."""

    name: str
    object: str
    """As for ``gibson-sim spawn``."""
    pose: PlanarPose
    z: float = 0.0
    """Height of its origin, metres."""


@dataclass(frozen=True, slots=True)
class Person:
    """A person who walks to and fro."""

    name: str
    path: tuple[tuple[float, float], ...]
    speed: float
    radius: float
    height: float


@dataclass(frozen=True, slots=True)
class RunSpec:
    """One planned run: all that was drawn, so that the same run can be made again, on any machine."""

    number: int
    scene: str
    robot: str
    """Name or file; a file in the run's folder where the robot is randomised."""
    seed: int
    """Of the simulation's noise, and of everything else that is drawn in the run."""
    start: PlanarPose
    goal: PlanarPose
    shortest: float
    """Length of the shortest path on the map, metres."""
    radius: float
    """Of the robot, metres."""
    initial_error: PlanarPose = (0.0, 0.0, 0.0)
    """Of the initial pose, in the robot's frame."""
    things: tuple[PlacedThing, ...] = ()
    closed_doors: tuple[str, ...] = ()
    people: tuple[Person, ...] = ()
    physics: dict[str, Any] = field(default_factory=dict)
    """Settings of the physics node, all that differ from its defaults, except scene, robot, start and seed."""
    drawn: dict[str, float] = field(default_factory=dict)
    """What was drawn for this run, such as ``slip``, for the report."""
    files: dict[str, str] = field(default_factory=dict)
    """Text files that belong to the run, by their path in its folder, such as ``robot/robot.yaml``."""

    def to_json(self) -> dict[str, Any]:
        """Returns the run as values of JSON."""
        return asdict(self)

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> RunSpec:
        """Returns the run that ``to_json`` returned."""
        return cls(**{
            **values,
            "start": tuple(values["start"]),
            "goal": tuple(values["goal"]),
            "initial_error": tuple(values["initial_error"]),
            "things": tuple(PlacedThing(**{**t, "pose": tuple(t["pose"])}) for t in values["things"]),
            "closed_doors": tuple(values["closed_doors"]),
            "people": tuple(Person(**{**p, "path": tuple(map(tuple, p["path"]))}) for p in values["people"]),
        })  # fmt: skip


End = Literal[
    "reached",  # the stack says so, or the robot stands at the goal
    "gave up",  # the stack says that it failed
    "time limit",  # simulation time
    "wall time limit",
    "never ready",
    "stack died",
    "stack silent",  # in lockstep it sent no answer in time
    "simulation failed",
    "interrupted",
]


@dataclass(frozen=True, slots=True)
class Outcome:
    """How a run ended."""

    end: End
    detail: str
    """One line: what, which value, which limit."""
    lockstep: bool
    """Whether time waited for the stack; else the run was in real time, and cannot be repeated with the stack to the bit."""
    goal_ns: int = -1
    """Stamp at which the goal was given; -1 = it was not."""
    decided_ns: int = -1
    """Stamp at which the stack told its end, or the robot began to stand at the goal; the run goes on until the robot stands still."""
    end_ns: int = -1
    """Stamp of the last tick."""
    exit_code: int | None = None
    """Of the stack, if it ended by itself; negative = the signal."""
    status: str = ""
    """Last text on the status topic."""
    refused_commands: int = 0
    """Commands that were not finite, or of another form."""
    start_up_s: float = 0.0
    """Wall time until simulation time began."""
    running_s: float = 0.0
    """Wall time in which simulation time passed."""
    ending_s: float = 0.0
    """Wall time from there until all processes had ended."""

    def to_json(self) -> dict[str, Any]:
        """Returns it as values of JSON."""
        return asdict(self)


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
"""What can go wrong first in a run."""


@dataclass(frozen=True, slots=True)
class Cause:
    """The first thing that went wrong in a failed run."""

    kind: CauseKind
    text: str
    """One sentence that tells what, where and when."""
    time: float | None = None
    """Seconds of simulation time after the goal was given."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """A run, judged."""

    run: RunSpec
    outcome: Outcome
    verdicts: tuple[Verdict, ...]
    measures: dict[str, float]
    """What was measured: ``time``, ``length``, ``path_ratio``, ``clearance``, ``goal_distance``, ``collisions``, ``rms_acceleration``,
    ``localisation_error``, ... SI units; what is unknown is left out."""
    digest: str
    """Of all that physics published in the run, tick by tick: equal digests = equal runs, to the bit. Empty = the bag has none."""
    cause: Cause | None = None
    """None = it passed."""

    @property
    def passed(self) -> bool:
        """Whether all verdicts are good."""
        return all(verdict.passed for verdict in self.verdicts)

    def to_json(self) -> dict[str, Any]:
        """Returns it as values of JSON, with ``passed``, and without the run's files, which are in its folder."""
        return {"passed": self.passed, **asdict(replace(self, run=replace(self.run, files={})))}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> RunResult:
        """Returns the result that ``to_json`` returned; its run has no files."""
        return cls(
            RunSpec.from_json(values["run"]),
            Outcome(**values["outcome"]),
            tuple(Verdict(**verdict) for verdict in values["verdicts"]),
            values["measures"],
            values["digest"],
            Cause(**values["cause"]) if values["cause"] else None,
        )
