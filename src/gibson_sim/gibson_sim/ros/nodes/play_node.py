"""The play node: publishes the messages of a bag at their recorded times."""

from __future__ import annotations

import math
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy
from rosgraph_msgs.msg import Clock

from gibson_sim import interrupts
from gibson_sim.bags.metadata import FOREVER_NS, TopicQos
from gibson_sim.bags.playback.options import PlayOptions
from gibson_sim.bags.playback.plan import CLOCK, Pace, PlayedTopic, messages_in_order, played_span, select_topics
from gibson_sim.bags.progress import progress_bar
from gibson_sim.bags.reader import BagReader
from gibson_sim.errors import AlreadyRunningError, ConfigError, EnvironmentProblemError
from gibson_sim.ros.nodes.node_main import is_running, run_node
from gibson_sim.ros.nodes.wait_for_simulation import WaitCondition
from gibson_sim.ros.topics import qos
from gibson_sim.ros.topics.discovery import DISCOVERY_S, LATE_DISCOVERY_S, is_fully_matched
from gibson_sim.ros.wire.fast_publish import FastClock
from gibson_sim.ros.wire.message_types import UNKNOWN, message_class
from gibson_sim.types import NS_PER_S

_WATCH_S = 1.0
"""Interval at which other publishers are looked for during the playback, s of wall time."""
_ACKNOWLEDGE_TIMEOUT_S = 10.0
"""Timeout for the acknowledgement of the last messages, s of wall time: a subscriber that was killed never acknowledges."""
_POLL_S = 0.05
"""Interval at which an end of the process and keys are checked, s of wall time."""
_MIN_REPETITION_S = 0.1
"""Minimum wall time between two repetitions of the bag, s, which may be as short as one message."""
_LATE_S = 0.5
"""Delay of the last message that is reported, s of wall time."""
_SHARED = ("/rosout", "/parameter_events", "/diagnostics")
"""Topics that normally have many publishers."""


class BagPlayer(Node):
    """Publishes the messages of a bag; ends with exit code 0 when the last one is acknowledged.

    Publishes:
        The selected topics of the bag, serialized as they were recorded; with ``clock``, /clock (rosgraph_msgs/Clock): the time of the
        playback.
    """

    def __init__(self, options: PlayOptions) -> None:
        """Opens the bag, and selects the topics.

        Raises:
            GibsonSimError: the bag cannot be read, or nothing of it can be played.
        """
        super().__init__("bag_player", enable_rosout=False, start_parameter_services=False)
        self._options = options
        if options.start_paused and not _is_foreground():
            raise ConfigError("--start-paused needs the foreground of a terminal on standard input: SPACE starts the playback")
        self._bag: BagReader | None = BagReader(options.bag)
        try:
            self._span = played_span(self._bag, options)
            self._topics = [topic for topic in select_topics(self._bag, options) if self._is_installed(topic)]
            self._publishers_of: dict[str, Publisher] = {}
            """Topic of the bag -> publisher."""
            if not self._topics:
                raise EnvironmentProblemError(f"no message type of bag {options.bag} is installed in this environment")
            if CLOCK in self._bag.topics() and not options.clock:
                self.get_logger().info(f"the bag's own {CLOCK} is not played; --clock publishes the time of the playback")
        except BaseException:
            self.close()
            raise
        self._played = 0
        self._expected_to_be_shared = set(_SHARED)
        """Topics of which no other publisher is reported."""
        self._next_check = 0.0
        """When other publishers are looked for again, s of time.monotonic()."""
        self._late_s = 0.0
        """Delay of the last message, s of wall time."""

    def _is_installed(self, topic: PlayedTopic) -> bool:
        """Returns whether the type of a topic is installed; warns if not."""
        try:
            message_class(topic.type_name)
        except UNKNOWN:
            self.get_logger().warning(f"{topic.name} is not played: its type {topic.type_name} is not installed here")
            return False
        return True

    def spin(self) -> int:
        """Plays the bag until its end or the end of the context; returns the exit code."""
        self._check_required_subscribers()
        if self._options.clock:
            # Before any publisher exists: a simulation withdraws its map for that of the bag, and one that has just started ends if it
            # sees a second clock.
            self._wait_for_discovery()
            self._check_other_publishers()
        self._create_publishers()
        self._wait_for_discovery()
        self._check_other_publishers()
        self._wait_for_subscribers()
        if not is_running():
            _say("stopped before the first message")
            return interrupts.INTERRUPTED
        self._check_other_publishers()
        options, number, reached_s = self._options, len(self._topics), 0.0
        rate = "" if options.rate == 1.0 else f" at {options.rate:g} times the recorded speed"
        _say(f"playing {options.bag}: {self._span.seconds:.1f} s, {number} topic{'s' * (number > 1)}{rate}")
        start = time.monotonic()
        with _Keys() as keys, progress_bar("playing", self._span.seconds / options.rate) as advance:
            while is_running():
                reached_s = self._play(keys, advance)
                if not options.loop:
                    break
        took_s = time.monotonic() - start
        if is_running():
            self._wait_until_acknowledged()
            late = f"; the last one {self._late_s:.1f} s late, since this machine is too slow" if self._late_s > _LATE_S else ""
            _say(f"played {self._played} messages in {took_s:.1f} s{late}")
            return 0
        _say(f"stopped at {reached_s:.1f} s of {self._span.seconds:.1f} s: played {self._played} messages")
        return 0 if options.loop else interrupts.INTERRUPTED

    # Start

    def _create_publishers(self) -> None:
        """Creates the publishers of all topics, and of the clock."""
        for topic in self._topics:
            kind = message_class(topic.type_name)
            self._publishers_of[topic.name] = self.create_publisher(kind, topic.published_as, _profile(topic.qos))
        if self._options.clock:
            self._publishers_of[CLOCK] = self.create_publisher(Clock, CLOCK, qos.CLOCK)

    def _check_required_subscribers(self) -> None:
        """Raises ConfigError if --wait-for has a topic that is not played."""
        played = {self.resolve_topic_name(topic.published_as) for topic in self._topics} | (
            {CLOCK} if self._options.clock else set()
        )
        unknown = sorted(self._options.required_subscribers().keys() - played)
        if unknown:
            raise ConfigError(f"--wait-for has {unknown[0]}, which is not played; played are {', '.join(sorted(played))}")

    def _wait_for_discovery(self) -> None:
        """Waits until the nodes that run already are discovered."""
        # Polls are counted, not seconds: on a machine that stalls, discovery stands still with this process.
        for _ in range(math.ceil(DISCOVERY_S / _POLL_S)):
            if not is_running():
                return
            time.sleep(_POLL_S)

    def _wait_for_subscribers(self) -> None:
        """Waits for the required subscribers, and until all discovered ones are matched, so that they receive the first messages."""
        required = self._options.required_subscribers()
        publishers = {publisher.topic_name: publisher for publisher in self._publishers_of.values()}
        conditions = [
            WaitCondition(
                self,
                f"{number} subscriber{'s' * (number > 1)} of {topic}",
                partial(_has_subscribers, publishers[topic], number),
            )
            for topic, number in required.items()
        ]
        has_waited = False
        while is_running() and not all(condition.is_met() for condition in conditions):
            has_waited = True
            time.sleep(_POLL_S)
        if has_waited:
            self._wait_for_discovery()  # of the other subscriptions of nodes that have just started
        start = time.monotonic()
        while is_running() and time.monotonic() - start < LATE_DISCOVERY_S:
            if all(is_fully_matched(self, publisher) for publisher in self._publishers_of.values()):
                return
            time.sleep(_POLL_S)

    def _check_other_publishers(self) -> None:
        """Warns of other publishers of the same topics, once for each topic.

        Raises:
            AlreadyRunningError: another node publishes /clock, and so does this one.
        """
        self._next_check = time.monotonic() + _WATCH_S
        own = [publisher.topic_name for publisher in self.publishers]
        shared = [topic for topic in dict.fromkeys(own) if self.count_publishers(topic) > own.count(topic)]
        if self._options.clock and self.count_publishers(CLOCK) > own.count(CLOCK):
            raise AlreadyRunningError(
                f"another node publishes {CLOCK} in this ROS domain, and time would jump back and forth: leave --clock out, stop that node, "
                "or choose another domain with --domain-id"
            )
        others = [topic for topic in shared if topic not in self._expected_to_be_shared]
        if others:
            self._expected_to_be_shared.update(others)
            self.get_logger().warning(
                f"other nodes publish {', '.join(others)}, too: subscribers receive both; choose other topics with --topics or --remap, "
                "or another domain with --domain-id"
            )

    # Playback

    def _play(self, keys: _Keys, advance: Callable[[float], None]) -> float:
        """Plays the bag once; returns the time that was reached, s from the start of the playback."""
        assert self._bag is not None
        options, span, clock = self._options, self._span, FastClock()
        repeated = self._played > 0
        self._sleep(max(options.delay, _MIN_REPETITION_S * repeated))
        clock_period_ns = max(1, round(options.rate / options.clock * NS_PER_S)) if options.clock else 0
        messages = messages_in_order(self._bag, self._topics, span, clock_period_ns)
        message = next(messages, None)  # opening the bag takes time, which the playback does not have
        pace = Pace(options.rate, span.start_ns, time.monotonic(), paused=options.start_paused and not repeated)
        if pace.paused:
            _say("paused at the start; SPACE resumes")
        reached_ns = span.start_ns
        while message is not None and is_running():
            self._handle_keys(keys, pace, reached_ns)
            if time.monotonic() > self._next_check:
                self._check_other_publishers()
            remaining_s = pace.remaining_s(message.time_ns, time.monotonic())
            if remaining_s > 0.0:
                time.sleep(min(remaining_s, _POLL_S))
                continue
            reached_ns, self._late_s = message.time_ns, -remaining_s
            publisher = self._publishers_of[message.topic]
            publisher.publish(clock.serialize(message.time_ns) if message.topic == CLOCK else message.data)
            self._played += message.topic != CLOCK
            advance((reached_ns - span.start_ns) / max(1, span.end_ns - span.start_ns))
            message = next(messages, None)
        return (reached_ns - span.start_ns) / NS_PER_S

    def _handle_keys(self, keys: _Keys, pace: Pace, reached_ns: int) -> None:
        """Pauses or resumes if SPACE was pressed."""
        if keys.pressed() != " ":
            return
        pace.toggle(time.monotonic())
        at_s = (reached_ns - self._span.start_ns) / NS_PER_S
        _say(f"paused at {at_s:.1f} s; SPACE resumes" if pace.paused else f"resumed at {at_s:.1f} s")

    def _sleep(self, seconds: float) -> None:
        """Sleeps, unless the end of the process is requested."""
        end = time.monotonic() + seconds
        while is_running() and (remaining := end - time.monotonic()) > 0.0:
            time.sleep(min(remaining, _POLL_S))

    def _wait_until_acknowledged(self) -> None:
        """Waits until all subscribers have acknowledged the messages; warns of topics where one has not."""
        deadline = time.monotonic() + _ACKNOWLEDGE_TIMEOUT_S
        waiting = list(self._publishers_of.values())
        while waiting and is_running() and time.monotonic() < deadline:
            waiting = [p for p in waiting if not p.wait_for_all_acked(Duration(nanoseconds=int(_POLL_S * 1e9)))]
        if waiting and is_running():
            topics = ", ".join(publisher.topic_name for publisher in waiting)
            self.get_logger().warning(f"a subscriber of {topics} has not acknowledged the last messages; it may have been killed")

    def close(self) -> None:
        """Closes the bag; a second call does nothing."""
        bag, self._bag = self._bag, None
        if bag is not None:
            bag.close()


class _Keys:
    """Reads single keys from the terminal while the process is in its foreground; without a terminal, there are none."""

    def __init__(self) -> None:
        self._before: list[Any] | None = None

    def __enter__(self) -> _Keys:
        if _is_foreground():
            self._before = termios.tcgetattr(sys.stdin)
            tty.setcbreak(sys.stdin)
        return self

    def __exit__(self, *_: object) -> None:
        before, self._before = self._before, None
        if before is not None and _is_foreground():
            termios.tcsetattr(sys.stdin, termios.TCSADRAIN, before)

    def pressed(self) -> str:
        """Returns the next key that was pressed; empty if there is none."""
        if self._before is None or not _is_foreground() or not select.select([sys.stdin], [], [], 0.0)[0]:
            return ""
        return os.read(sys.stdin.fileno(), 1).decode(errors="ignore")


def _is_foreground() -> bool:
    """Returns whether this process may use the terminal: the kernel stops a background process that reads from it."""
    try:
        return sys.stdin is not None and sys.stdin.isatty() and os.tcgetpgrp(sys.stdin.fileno()) == os.getpgrp()
    except OSError:  # not the controlling terminal: its keys are meant for another process
        return False


def _has_subscribers(publisher: Publisher, number: int) -> bool:
    return publisher.get_subscription_count() >= number


def _profile(topic: TopicQos) -> QoSProfile:
    """Returns the profile of a publisher."""
    times = {
        name: Duration(nanoseconds=value)
        for name, value in (
            ("deadline", topic.deadline_ns),
            ("lifespan", topic.lifespan_ns),
            ("liveliness_lease_duration", topic.liveliness_lease_duration_ns),
        )
        if value < FOREVER_NS
    }
    return QoSProfile(
        history=HistoryPolicy[topic.history.upper()],
        depth=topic.depth,
        reliability=ReliabilityPolicy[topic.reliability.upper()],
        durability=DurabilityPolicy[topic.durability.upper()],
        liveliness=LivelinessPolicy[topic.liveliness.upper()],
        **times,
    )


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")


def main() -> None:
    """Runs the node with the options in the JSON on the command line."""
    options = PlayOptions.from_json(sys.argv[1])
    run_node(lambda: BagPlayer(options), [], interrupted=interrupts.INTERRUPTED)


if __name__ == "__main__":
    main()
