"""Runs the drives of one path in this process: ``run_path`` is the unit of work. Each run appends a line of JSON to the file of its path."""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from gibson_path_following.errors import PathFollowingError
from gibson_path_following.images.goggles import DEFAULT_MODEL as DEFAULT_GOGGLES, ColourReference, Goggles, make_goggles
from gibson_path_following.policies.backends import make_policy
from gibson_path_following.policies.follower import FollowerSettings, PathFollower
from gibson_path_following.policies.path_model import DEFAULT_MODEL
from gibson_path_following.types import Place, Velocity
from gibson_sim.errors import ConfigError, SceneError
from gibson_sim.jobs.units import Context
from gibson_sim.reading import read_file
from gibson_sim.writing import cannot_write
from gibson_sim_bench.path_following.plan import RunKey, parts_of, seeds_of
from gibson_sim_learn.path_following.cameras import Rig
from gibson_sim_learn.path_following.cases import PathCase
from gibson_sim_learn.path_following.domains import Conditions, domain_of, draw
from gibson_sim_learn.path_following.drives import (
    BlindDriver,
    Driver,
    FollowerDriver,
    Observation,
    PathSite,
    RandomDriver,
    Recording,
    Trace,
    follow,
    oracle_for,
    record,
)
from gibson_sim_learn.path_following.layout import Layout

UNIT = "gibson_sim_bench.path_following.runs:run_path"
SUCCESS = "success"
_MAX_MODEL_BYTES = 200_000_000
"""Largest network that is read."""


@dataclass(frozen=True, slots=True)
class RunResult:
    """Result of one run."""

    key: RunKey
    kind: str
    """``success``, or the kind of failure in a few words."""
    success: bool
    arrived: bool
    coverage: float
    collisions: int
    travelled: float
    """Distance driven, metres."""
    deviation_mean: float
    """Mean distance from the path, metres."""
    deviation_max: float
    """Largest distance from the path, metres."""
    end_distance: float
    """Distance from the last node at the end, metres."""
    spl: float
    """Success weighted by path length."""
    duration: float
    """Duration of the drive, seconds of simulation time."""
    ended: str
    """Why the drive ended: finished, standing, time."""
    state: str
    """State of the driver at the end."""
    touched: tuple[str, ...] = ()
    moved: int = 0
    """Number of objects moved or added since the recording."""
    obstacles: int = 0
    """Number of obstacles on the path."""
    seconds: float = 0.0
    """Processor time of the run, seconds."""
    places: int = 0
    """Number of images in which the driver followed the path by an estimated place."""
    near_places: int = 0
    """Number of them whose place is at most one node from the true one."""

    def as_line(self) -> str:
        """Returns the result as a line of JSON."""
        return json.dumps(asdict(self))


def result_of(values: Any) -> RunResult:
    """Returns the result in a parsed line of JSON.

    Raises:
        ConfigError: the line holds none.
    """
    try:
        fields = dict(values)
        key = RunKey(**fields.pop("key"))
        return RunResult(key=key, **{**fields, "touched": tuple(fields["touched"])})
    except (TypeError, KeyError, ValueError) as error:
        raise ConfigError(f"a result of a run is not as this version writes it: {error}; choose another folder") from error


def policy_digest(model: str) -> str:
    """Returns the first digits of the digest of a network; empty = there is none.

    Args:
        model: file; empty = the one that is shipped.

    Raises:
        ConfigError: the file that is named cannot be read.
    """
    return _digest("--model", model, DEFAULT_MODEL)


def goggles_digest(model: str) -> str:
    """Returns the same for the network of the Goggles; arguments and errors as of ``policy_digest``."""
    return _digest("--goggles", model, DEFAULT_GOGGLES)


def _digest(option: str, model: str, shipped: Path) -> str:
    file = Path(model) if model else shipped
    if not model and not file.is_file():
        return ""
    try:
        return hashlib.sha256(read_file(file, _MAX_MODEL_BYTES)).hexdigest()[:16]
    except OSError as error:
        raise ConfigError(f"{option} {file}: cannot be read: {error.strerror}; name an ONNX file of gibson-sim learn") from error


class GogglesDriver:
    """A driver whose images pass through Goggles first.

    Args:
        driver: gets the adapted images.
        goggles: adapt the images.
    """

    needs_view = True

    def __init__(self, driver: Driver, goggles: Goggles) -> None:
        self._driver, self._goggles = driver, goggles

    @property
    def place(self) -> Place | None:
        """As of the driver."""
        return self._driver.place

    @property
    def state(self) -> str:
        """As of the driver."""
        return self._driver.state

    def drive(self, observation: Observation) -> Velocity:
        """Returns the velocity until the next tick."""
        return self._driver.drive(replace(observation, view=tuple(self._goggles(image) for image in observation.view)))


class Runner:
    """Runs drives; it keeps the scene that was used last, and its last recording.

    Args:
        seed: seed of the plan.
        rig: cameras.
        model: ONNX file of ``learned``; empty = the one that is shipped.
        goggles: ONNX file of ``+goggles``; empty = the one that is shipped.
    """

    def __init__(self, seed: int, rig: Rig, model: str = "", goggles: str = "") -> None:
        self._seed, self._rig, self._model, self._goggles = seed, rig, model, goggles
        self._site: PathSite | None = None
        self._recording: Recording | None = None

    def site(self, scene: str) -> PathSite:
        """Returns a loaded scene."""
        if self._site is None or self._site.scene != scene:
            self.close()
            self._site = PathSite(scene, rig=self._rig)
        return self._site

    def recording(self, case: PathCase) -> Recording:
        """Returns the recording of a path by the oracle."""
        if self._recording is None or self._recording.case != case:
            self._recording = record(self.site(case.scene), case, seed=self._seed)
        return self._recording

    def conditions(self, key: RunKey) -> Conditions:
        """Returns the conditions of a run."""
        return draw(domain_of(key.domain), np.random.default_rng(seeds_of(self._seed, key)))

    def trace(self, case: PathCase, key: RunKey, *, keep_views: bool = False) -> Trace:
        """Returns the drive of a run.

        Raises:
            GibsonSimError: it cannot be made.
        """
        recording, conditions, site = self.recording(case), self.conditions(key), self.site(case.scene)
        rng = np.random.default_rng([*seeds_of(self._seed, key), 1])
        return follow(
            site,
            recording,
            lambda layout: self._driver(key.method, site, recording, layout, conditions, rng),
            conditions,
            int(rng.integers(2**31)),
            keep_views=keep_views,
        )

    def run(self, case: PathCase, key: RunKey) -> RunResult:
        """Runs a drive; returns its result."""
        self.recording(case)  # once for many runs: its time is not that of a run
        began = time.process_time()
        try:
            trace = self.trace(case, key)
        except SceneError as error:
            return RunResult(
                key, f"not run: {error}", False, False, 0.0, 0, 0.0, 0.0, 0.0, case.length, 0.0, 0.0, "not run", "",
                seconds=time.process_time() - began,
            )  # fmt: skip
        outcome, errors = trace.outcome(self.recording(case)), trace.place_errors(self.recording(case))
        layout = trace.layout
        assert layout is not None
        return RunResult(
            key,
            kind=kind_of(trace, success=outcome.success, arrived=outcome.arrived, collisions=outcome.collisions),
            success=outcome.success,
            arrived=outcome.arrived,
            coverage=outcome.coverage,
            collisions=outcome.collisions,
            travelled=round(outcome.travelled, 4),
            deviation_mean=round(outcome.deviation_mean, 4),
            deviation_max=round(outcome.deviation_max, 4),
            end_distance=round(outcome.end_distance, 4),
            spl=round(outcome.spl, 4),
            duration=outcome.duration,
            ended=trace.ended,
            state=trace.ticks[-1].state,
            touched=trace.touched,
            moved=len(layout.moved),
            obstacles=len(layout.obstacles),
            seconds=round(time.process_time() - began, 3),
            places=len(errors),
            near_places=int(np.count_nonzero(errors <= 1.0)),
        )

    def _driver(
        self, method: str, site: PathSite, recording: Recording, layout: Layout, conditions: Conditions, rng: np.random.Generator
    ) -> Driver:
        if method == "oracle":
            return oracle_for(site, recording, layout, conditions)
        if method == "blind":
            return BlindDriver(recording)
        if method == "random":
            return RandomDriver(recording, rng)
        base, kind = parts_of(method)
        backend = f"learned:{self._model}" if base == "learned" and self._model else base
        try:
            policy, localiser = make_policy(backend, recording.path)
            driver = FollowerDriver(PathFollower(recording.path, policy, FollowerSettings(), localiser))
            if not kind:
                return driver
            mode = "learned" if kind == "goggles" else kind
            return GogglesDriver(driver, make_goggles(mode, self._goggles, ColourReference.of_path(recording.path)))
        except PathFollowingError as error:
            raise ConfigError(f"method {method}: {error}") from error

    def close(self) -> None:
        """Closes the scene; a second call does nothing."""
        site, self._site, self._recording = self._site, None, None
        if site is not None:
            site.close()


def kind_of(trace: Trace, *, success: bool, arrived: bool, collisions: int) -> str:
    """Returns ``success``, or the kind of failure: the first collision, else why the robot did not arrive."""
    if success:
        return SUCCESS
    if collisions and trace.touched:
        layout, first = trace.layout, trace.touched[0]
        if layout is not None and first in layout.obstacles:
            return "hit an obstacle"
        return "hit a moved object" if layout is not None and first in layout.moved else "hit the scene"
    state = trace.ticks[-1].state
    if arrived:
        return "touched something"
    if state == "finished":
        return "ended elsewhere"
    if state == "lost":
        return "lost"
    return "stood still" if trace.ended == "standing" else "out of time"


_KEPT: dict[tuple[int, str, str, str], Runner] = {}
"""The runner of a worker process, which keeps its scene from one unit to the next."""


def run_path(arguments: dict[str, Any], folder: Path, context: Context) -> int:
    """Runs the drives of one path, and appends a line for each to its file; returns their number. A unit of work, see ``jobs``."""
    settings = (arguments["seed"], arguments["camera"], arguments["model"], arguments["goggles"])
    if settings not in _KEPT:
        for runner in _KEPT.values():
            runner.close()
        _KEPT.clear()
        _KEPT[settings] = Runner(settings[0], Rig(settings[1]), *settings[2:])
    case = case_of(arguments["case"])
    keys = [RunKey(**values) for values in arguments["keys"]]
    return make_runs(_KEPT[settings], case, keys, Path(arguments["file"]), context.stop, context.progress)


def make_runs(
    runner: Runner,
    case: PathCase,
    keys: Sequence[RunKey],
    file: Path,
    stop: Callable[[], bool] = lambda: False,
    progress: Callable[[str], None] = lambda text: None,
) -> int:
    """Runs drives of one path, appends their lines to a file, and returns their number.

    Raises:
        WriteError: the file cannot be written.
    """
    for k, key in enumerate(keys):
        if stop():
            return k
        result = runner.run(case, key)
        try:
            with file.open("ab") as lines:
                # One write: a line is complete, or its end is missing and it is ignored.
                lines.write((result.as_line() + "\n").encode())
        except OSError as error:
            raise cannot_write(file, error) from error
        progress(f"{key.domain}, {key.method}: {result.kind}")
    return len(keys)


def case_of(values: dict[str, Any]) -> PathCase:
    """Returns the path of a parsed JSON object."""
    return PathCase(**{**values, "line": tuple((float(x), float(y)) for x, y in values["line"])})
