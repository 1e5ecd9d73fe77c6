"""Metrics of one episode and of many, computed from observations and contacts. Pure."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from gibson_sim.tasks.episode import Episode, Observation, item_root
from gibson_sim.types import Contact

PUSHED = 0.05
"""Displacement up to which an item counts as not pushed, metres."""
_LEVEL = 0.7
"""Minimum absolute z of the unit normal of contacts with floors and payloads, which are not collisions."""
_LEAST_FORCE = 1e-3
"""Minimum force of a touch, N."""
_Z95 = 1.959964
"""Half width of the 95 % interval of a standard normal distribution."""


@dataclass(frozen=True, slots=True)
class Metrics:
    """Metrics of an episode so far."""

    success: bool
    time: float
    """Duration, seconds of simulation time."""
    path_length: float
    """Length of the path of the base, metres."""
    spl: float
    """Success weighted by path length (Anderson et al. 2018): shortest / max(shortest, path_length), 0 without success; NaN = the task
    has no shortest path."""
    collisions: int
    """Number of times the robot began to touch a static obstacle other than the floor."""
    pushed: int
    """Number of displaced items, without the target."""
    pushed_distance: float
    """Sum of the displacements of pushed items, metres."""
    goal_distance: float
    """Remaining distance to the goal, in the unit of the task: metres, or radians of a joint."""


class Meter:
    """Accumulates the metrics of one episode.

    Args:
        episode: the episode.
        begin: first observation of the episode.
    """

    def __init__(self, episode: Episode, begin: Observation) -> None:
        self._episode = episode
        self._roots = {item.name: item_root(item) for item in episode.items if item.name != episode.goal.target}
        self._first = {name: begin.links[root].position for name, root in self._roots.items()}
        self._last_xy = begin.xy
        self._touched: frozenset[str] = frozenset()
        self._collisions, self._path_length = 0, 0.0

    def update(self, obs: Observation, touched: Collection[str]) -> None:
        """Adds an observation and the names of the static obstacles that the robot touches."""
        self._path_length += math.dist(obs.xy, self._last_xy)
        self._last_xy = obs.xy
        self._collisions += len(frozenset(touched) - self._touched)
        self._touched = frozenset(touched)

    @property
    def touching(self) -> bool:
        """Whether the robot touched a static obstacle in the last observation."""
        return bool(self._touched)

    def metrics(self, obs: Observation, *, success: bool, goal_distance: float) -> Metrics:
        """Returns the metrics up to ``obs``."""
        moved = [math.dist(obs.links[root].position, self._first[name]) for name, root in self._roots.items()]
        pushed = [distance for distance in moved if distance > PUSHED]
        shortest = self._episode.shortest
        spl = shortest / max(self._path_length, shortest, 1e-9) if success else 0.0
        return Metrics(
            success=success,
            time=obs.time,
            path_length=self._path_length,
            spl=math.nan if math.isnan(shortest) else spl,
            collisions=self._collisions,
            pushed=len(pushed),
            pushed_distance=sum(pushed),
            goal_distance=goal_distance,
        )


def touched_by(robot: str, contacts: Sequence[Contact], moving: Collection[str]) -> frozenset[str]:
    """Returns the names of the static obstacles in lateral contact with a robot.

    Args:
        robot: name of the robot.
        contacts: contacts in which a static obstacle is always ``body_b``.
        moving: names of robots and bodies.
    """
    with_obstacles = (c for c in contacts if c.body_a == robot and c.body_b not in moving)
    return frozenset(c.body_b for c in with_obstacles if abs(c.normal[2]) < _LEVEL and c.force > 0.0)


def touch_direction(robot: str, contacts: Sequence[Contact], yaw: float, ignored: Collection[str] = ()) -> tuple[float, float]:
    """Returns the force-weighted mean direction of lateral contacts of a robot: unit vector, x, y in the base frame; zeros = no contact.

    Args:
        robot: name of the robot.
        contacts: contacts in which the robot is ``body_a``.
        yaw: heading of the robot, radians.
        ignored: names of bodies to ignore.
    """
    x = y = 0.0
    for contact in contacts:
        if contact.body_a == robot != contact.body_b and contact.body_b not in ignored and abs(contact.normal[2]) < _LEVEL:
            x, y = x - contact.force * contact.normal[0], y - contact.force * contact.normal[1]
    length = math.hypot(x, y)
    if length < _LEAST_FORCE:
        return 0.0, 0.0
    c, s = math.cos(yaw), math.sin(yaw)
    return (c * x + s * y) / length, (c * y - s * x) / length


@dataclass(frozen=True, slots=True)
class EpisodeSummary:
    """Metrics of many episodes of a task."""

    episodes: int
    successes: int
    low: float
    """Lower end of the 95 % interval of the success rate (Wilson)."""
    high: float
    """Upper end of the 95 % interval of the success rate (Wilson)."""
    time: float
    """Median duration of successful episodes, seconds; NaN = no success."""
    spl: float
    """Mean SPL; NaN = the task has no shortest path."""
    collisions: float
    """Mean number of collisions."""
    pushed: float
    """Mean number of pushed items."""

    @property
    def rate(self) -> float:
        """Fraction of episodes that succeeded; NaN without episodes."""
        return self.successes / self.episodes if self.episodes else math.nan


def summary(episodes: Sequence[Metrics]) -> EpisodeSummary:
    """Returns the summary of episodes."""
    count, successes = len(episodes), sum(m.success for m in episodes)
    low, high = wilson(successes, count)
    times = sorted(m.time for m in episodes if m.success)
    return EpisodeSummary(
        episodes=count,
        successes=successes,
        low=low,
        high=high,
        time=times[len(times) // 2] if times else math.nan,
        spl=_mean([m.spl for m in episodes]),
        collisions=_mean([m.collisions for m in episodes]),
        pushed=_mean([m.pushed for m in episodes]),
    )


def wilson(successes: int, count: int) -> tuple[float, float]:
    """Returns the 95 % interval of a rate (Wilson 1927); (0, 1) for a count of 0."""
    if not count:
        return 0.0, 1.0
    rate, z = successes / count, _Z95
    middle = rate + z * z / (2 * count)
    spread = z * math.sqrt(rate * (1 - rate) / count + z * z / (4 * count * count))
    scale = 1 + z * z / count
    return max(0.0, (middle - spread) / scale), min(1.0, (middle + spread) / scale)


def _mean(values: Sequence[float]) -> float:
    return sum(values) / len(values) if values else math.nan


def episode_line(seed: int, metrics: Metrics) -> str:
    """Returns a one-line report of an episode."""
    spl = "" if math.isnan(metrics.spl) else f", SPL {metrics.spl:.2f}"
    return (
        f"seed {seed}: {'success' if metrics.success else 'failure'} after {metrics.time:.1f} s, {metrics.path_length:.2f} m{spl}, "
        f"{metrics.collisions} collisions, {metrics.pushed} items pushed by {metrics.pushed_distance:.2f} m, {metrics.goal_distance:.2f} left"
    )


def summary_line(task: str, baseline: str, total: EpisodeSummary) -> str:
    """Returns a one-line report of many episodes."""
    spl = "" if math.isnan(total.spl) else f", mean SPL {total.spl:.2f}"
    time = "" if math.isnan(total.time) else f", median time {total.time:.1f} s"
    return (
        f"{task}, {baseline}: {total.successes} of {total.episodes} succeeded ({100 * total.rate:.0f} %, 95 % interval "
        f"{100 * total.low:.0f} to {100 * total.high:.0f} %){spl}{time}, mean {total.collisions:.1f} collisions, {total.pushed:.1f} pushed"
    )


def episode_values(metrics: Metrics | EpisodeSummary) -> dict[str, Any]:
    """Returns the values for JSON; NaN becomes None."""
    return {name: None if isinstance(v, float) and math.isnan(v) else v for name, v in asdict(metrics).items()}
