"""The rows of ``gibson-sim bench table1``: a configuration, its stages, and the limits measured with it. Pure."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from gibson_sim_bench.reports.paper import FILL, PAPER_SCENES, RENDERING_SIZE, SENSOR_ONLY, mode_of
from gibson_sim_bench.ros import PerformanceTarget, without_nan
from gibson_sim_bench.timing import Facts

IN_PROCESS, LOCKSTEP, FREE = "in process", "lockstep", "free-running"
HOST, TENSOR = "host", "tensor"
BULLET, OPENGL, COPY, DDS = "Bullet alone", "OpenGL alone", "copies alone", "DDS alone"
ENOUGH = 0.7
"""Fraction of the limit at which a row needs no explanation."""


@dataclass(frozen=True, slots=True)
class Table1Row:
    """Frames per second of one configuration."""

    way: str
    """Configuration: ``in process``, ``lockstep`` or ``free-running``."""
    to: str
    """Destination of the images: ``host`` or ``tensor``."""
    mode: str
    """Name in ``paper.MODES``, or in ``protocol.RENDERING_MODES``."""
    scene: str
    triangles: int
    width: int
    height: int
    substeps: int
    """Physics steps of 1/240 s per frame; 0 = no physics."""
    fps: float
    """1 / median time of a frame."""
    p5: float
    p95: float
    frames: int
    stages: dict[str, float] = field(default_factory=dict)
    """Median milliseconds per frame by stage, each completed before the next; their sum may exceed the time of a frame."""
    bounds: dict[str, float] = field(default_factory=dict)
    """Milliseconds per frame of each part measured alone, on the same machine."""
    lost: float = math.nan
    """Fraction of ticks without a received message: not rendered in time, or lost in transport; NaN = not applicable."""

    @property
    def key(self) -> str:
        """Identifies the row in one line, equal in all reports."""
        physics = f"{self.substeps} substeps" if self.substeps else "no physics"
        return f"{self.way}, {self.to}: {self.mode}, {self.scene}, {self.width}x{self.height}, {physics}"

    @property
    def bound_fps(self) -> float:
        """Limit: frames per second if only the parts measured alone took time, one after the other; NaN = not measured."""
        total = sum(self.bounds.values())
        return 1e3 / total if total > 0.0 else math.nan

    @property
    def share(self) -> float:
        """Fraction of ``bound_fps`` that the row reaches."""
        return self.fps / self.bound_fps

    @property
    def overhead_ms(self) -> dict[str, float]:
        """Milliseconds per frame beyond the parts measured alone, by cause, the largest first."""
        s, b = self.stages, self.bounds
        found = {
            "Python around the step": s.get("step", 0.0) - b.get(BULLET, 0.0) if BULLET in b else 0.0,
            "reading the state": s.get("convert", 0.0),
            "level of detail, culling": s.get("draw", 0.0) - b.get(OPENGL, 0.0),
            "hole filling": s.get("fill", 0.0),
            "readback": s.get("read back", 0.0) - b.get(COPY, 0.0),
            "serialization": s.get("encode", 0.0),
        }
        total = 1e3 / self.fps - sum(b.values())
        found["waiting, CPU contention"] = total - sum(found.values())
        return dict(sorted(((n, ms) for n, ms in found.items() if ms > 0.0), key=lambda pair: -pair[1])) if s else {}

    @property
    def bound_by(self) -> str:
        """The slowest of the parts measured alone; empty = none was measured."""
        return max(self.bounds, key=lambda name: self.bounds[name], default="")


@dataclass(frozen=True, slots=True)
class Table1:
    """The measurements, with the machine."""

    facts: Facts
    robot: str
    tensors_on: str
    rows: tuple[Table1Row, ...] = ()
    left_out: tuple[str, ...] = ()

    def as_json(self) -> dict[str, Any]:
        """Returns the report as JSON types; NaN becomes null."""
        rows = [
            {
                **asdict(row),
                "bound_by": row.bound_by,
                "bound_fps": row.bound_fps,
                "share": row.share,
                "between": row.overhead_ms,
                "paper": paper_of(row),
            }
            for row in self.rows
        ]
        found = {
            "kind": "table1",
            "facts": asdict(self.facts),
            "robot": self.robot,
            "tensors_on": self.tensors_on,
            "rows": rows,
            "filled_by": FILL,
            "left_out": self.left_out,
            "targets": [asdict(target) for target in targets(self.rows)],
            "figures": [{"name": row.key, "value": row.fps, "unit": "frames/s", "better": "more"} for row in self.rows],
        }
        cleaned: dict[str, Any] = without_nan(found)
        return cleaned


def table_of(read: Mapping[str, Any]) -> Table1:
    """Returns a report from its JSON."""
    names = [name for name in Table1Row.__dataclass_fields__ if name != "lost"]
    rows = [Table1Row(**{n: r[n] for n in names}, lost=math.nan if r["lost"] is None else r["lost"]) for r in read["rows"]]
    return Table1(Facts(**read["facts"]), read["robot"], read["tensors_on"], tuple(rows), tuple(read["left_out"]))


def paper_of(row: Table1Row) -> dict[str, float | None]:
    """Returns the paper's values for a row, ``v2``, ``v1`` and ``habitat``, frames per second; None = not in the paper."""
    not_in_paper: dict[str, float | None] = {"v2": None, "v1": None, "habitat": None}
    if row.substeps:
        mode = mode_of(row.mode)
        return {**not_in_paper, "v2": mode.v2, "v1": mode.v1}
    if (row.width, row.height) != RENDERING_SIZE or row.mode != "RGB":
        return not_in_paper
    fastest = max(PAPER_SCENES, key=lambda scene: scene[1])
    return {**not_in_paper, "v2": fastest[1], "habitat": fastest[2]}


def row_of(times: Sequence[float], **values: Any) -> Table1Row:
    """Returns a row from the durations of the frames, seconds."""
    rates = 1.0 / np.asarray(times, dtype=np.float64)
    low, middle, high = (round(float(np.percentile(rates, p)), 2) for p in (5, 50, 95))
    return Table1Row(fps=middle, p5=low, p95=high, frames=len(times), **values)


def lockstep_row(times: Sequence[float], in_process: Table1Row, message_ms: Mapping[str, float]) -> Table1Row:
    """Returns the lockstep row that corresponds to a row in process.

    Args:
        times: seconds from tick to tick.
        in_process: the corresponding row in process.
        message_ms: milliseconds of convert, encode, publish and transport, measured alone.
    """
    bounds = {**in_process.bounds, DDS: _dds(message_ms)}
    return row_of(times, way=LOCKSTEP, stages=_stages(in_process, message_ms), bounds=bounds, **_shared_fields(in_process))


def free_row(received_ns: Sequence[int], ticks: int, in_process: Table1Row, message_ms: Mapping[str, float]) -> Table1Row:
    """Returns the row of a free-running simulation with a subscriber; physics and rendering are separate processes.

    Args:
        received_ns: times at which sets of images became complete, or odometry arrived, nanoseconds.
        ticks: number of ticks of the simulation in that time.
        in_process: the corresponding row in process.
        message_ms: as for ``lockstep_row``.
    """
    times = np.diff(np.asarray(received_ns, dtype=np.float64)) / 1e9
    bounds = {name: ms for name, ms in in_process.bounds.items() if name != BULLET or in_process.mode == SENSOR_ONLY}
    if in_process.mode != SENSOR_ONLY:
        bounds[DDS] = _dds(message_ms)
    row = row_of(times.tolist(), way=FREE, stages=_stages(in_process, message_ms), bounds=bounds, **_shared_fields(in_process))
    # The mean rate: messages that arrive in bursts would distort a median.
    return replace(row, fps=round(1.0 / float(times.mean()), 2), lost=max(0.0, 1.0 - len(received_ns) / max(1, ticks)))


def _shared_fields(row: Table1Row) -> dict[str, Any]:
    """Returns the fields that a row over ROS has in common with its row in process."""
    names = ("to", "mode", "scene", "triangles", "width", "height", "substeps")
    return {name: getattr(row, name) for name in names}


def _dds(message_ms: Mapping[str, float]) -> float:
    return round(message_ms["publish"] + message_ms["transport"], 5)


def _stages(in_process: Table1Row, message_ms: Mapping[str, float]) -> dict[str, float]:
    return {**in_process.stages, **message_ms, "convert": round(in_process.stages.get("convert", 0.0) + message_ms["convert"], 5)}


SENSOR_FPS, RGBD_FPS, ALL_FPS, SENSOR_24_FPS, MIN_LOCKSTEP_RATIO = 3000.0, 150.0, 100.0, 400.0, 0.8
"""Targets for two cores without a GPU, frames per second in process with 1 substep and with 24; rate in lockstep relative to in process."""
_IN_PROCESS_TARGETS = (
    (SENSOR_ONLY, 1, SENSOR_FPS),
    ("RGB-D, pre-filled", 1, RGBD_FPS),
    ("all outputs", 1, ALL_FPS),
    (SENSOR_ONLY, 24, SENSOR_24_FPS),
)


def targets(rows: Sequence[Table1Row]) -> list[PerformanceTarget]:
    """Returns the targets for two cores that the rows cover."""
    found = []
    physics = [row for row in rows if row.substeps and row.to == HOST]
    alone = {(row.mode, row.substeps): row.fps for row in physics if row.way == IN_PROCESS}
    for mode, substeps, required in _IN_PROCESS_TARGETS:
        if (mode, substeps) in alone:
            fps = alone[mode, substeps]
            what = f"{mode}, {substeps} substep{'s' if substeps > 1 else ''}, in process"
            found.append(PerformanceTarget(what, f"> {required:,.0f}/s", f"{fps:,.0f}/s", "", fps > required))
    for row in physics:
        if row.way == LOCKSTEP and row.substeps == 1 and row.mode != SENSOR_ONLY and (row.mode, 1) in alone:
            ratio = row.fps / alone[row.mode, 1]
            what = f"{row.mode}, lockstep relative to in process"
            found.append(
                PerformanceTarget(
                    what, f"> {100 * MIN_LOCKSTEP_RATIO:.0f} %", f"{100 * ratio:.0f} %", "", ratio > MIN_LOCKSTEP_RATIO
                )
            )
    return found
