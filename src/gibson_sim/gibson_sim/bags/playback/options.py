"""Options of a playback. Must not import rclpy."""

from __future__ import annotations

import json
import re
from dataclasses import asdict, dataclass
from typing import Any

from gibson_sim.config import absolute_name, parse_subscribers
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted

DEFAULT_CLOCK_HZ = 40.0
"""Rate of /clock for ``--clock`` without a number, Hz of wall time, as in rosbag2."""
_MAX_CLOCK_HZ, _MAX_RATE = 10_000.0, 1000.0
_MAX_S = 1e9
"""Maximum of a time in the options, s."""
_TOPIC = re.compile(r"(/[A-Za-z_]\w*)+", re.ASCII)
_REMAP = ":="


@dataclass(frozen=True, slots=True)
class PlayOptions:
    """Options of a playback, with the names and meanings of ``ros2 bag play``."""

    bag: str
    """Folder of the bag."""
    rate: float = 1.0
    """Seconds of the bag per second of wall time."""
    topics: tuple[str, ...] = ()
    """Topics to play; empty = all."""
    exclude_topics: tuple[str, ...] = ()
    """Topics not to play."""
    remap: tuple[str, ...] = ()
    """Rules ``/old:=/new``: the topic ``/old`` of the bag is published as ``/new``."""
    loop: bool = False
    """Whether to start again at the end."""
    start_offset: float = 0.0
    """Time from the start of the bag to the start of the playback, s."""
    playback_duration: float | None = None
    """Time of the bag that is played, s; None = to its end."""
    clock: float | None = None
    """Rate at which the time of the playback is published on /clock, Hz of wall time; None = never."""
    delay: float = 0.0
    """Wall time before the playback, and before each repetition, s."""
    wait_for: tuple[str, ...] = ()
    """Published topics, each with an optional ``:N``, that must have N subscribers (1) before the playback starts."""
    start_paused: bool = False
    """Whether to wait for SPACE before the first message."""

    def __post_init__(self) -> None:
        if not 0.0 < self.rate <= _MAX_RATE:
            raise ConfigError(
                f"--rate is {self.rate:g}, must be above 0 and at most {_MAX_RATE:g}, such as 2 for twice the recorded speed"
            )
        for flag, seconds in (("--start-offset", self.start_offset), ("--delay", self.delay)):
            if not 0.0 <= seconds <= _MAX_S:
                raise ConfigError(f"{flag} is {seconds:g} s, must be 0 or more")
        if self.playback_duration is not None and not 0.0 < self.playback_duration <= _MAX_S:
            raise ConfigError(f"--playback-duration is {self.playback_duration:g} s, must be above 0; without it, all is played")
        if self.clock is not None and not 0.0 < self.clock <= _MAX_CLOCK_HZ:
            raise ConfigError(
                f"--clock is {self.clock:g} Hz, must be above 0 and at most {_MAX_CLOCK_HZ:g}; without it, none is published"
            )
        self.remapped()
        self.required_subscribers()

    @classmethod
    def from_json(cls, text: str) -> PlayOptions:
        """Returns the options in a text of ``to_json``."""
        values: dict[str, Any] = json.loads(text)
        arguments: dict[str, Any] = {name: tuple(value) if isinstance(value, list) else value for name, value in values.items()}
        return cls(**arguments)

    def to_json(self) -> str:
        """Returns the options as text."""
        return json.dumps(asdict(self))

    def remapped(self) -> dict[str, str]:
        """Returns topic of the bag -> topic on which it is published, for topics with a rule.

        Raises:
            ConfigError: a rule is not ``/old:=/new``.
        """
        rules = {}
        for rule in self.remap:
            old, _, new = rule.partition(_REMAP)
            old, new = absolute_name(old), absolute_name(new)
            if not (_TOPIC.fullmatch(old) and _TOPIC.fullmatch(new)):
                raise ConfigError(f"--remap has {quoted(rule)}, must be OLD:=NEW, such as /camera/image_raw:=/image")
            rules[old] = new
        return rules

    def required_subscribers(self) -> dict[str, int]:
        """Returns topic of ``wait_for`` -> required number of subscribers.

        Raises:
            ConfigError: an entry is neither ``TOPIC`` nor ``TOPIC:N``.
        """
        return {absolute_name(topic): number for topic, number in parse_subscribers("--wait-for", self.wait_for).items()}
