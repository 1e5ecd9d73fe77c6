"""Quality of service of every topic.

Sensor data is published reliable (REP 2003): a reliable reader never matches a best-effort writer, while a best-effort reader matches both.
History, depth and reliability of a publisher with ``overridable`` can be changed at the start of its node, by the parameters
``qos_overrides.<topic>.publisher.history``, ``.depth`` and ``.reliability``; the topic is the full name, such as ``/camera/image_raw``.
"""

from __future__ import annotations

from typing import Any

from rclpy.event_handler import PublisherEventCallbacks
from rclpy.exceptions import InvalidParameterTypeException
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions

from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted


def _profile(depth: int, *, latched: bool = False) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


SENSOR = _profile(5)
"""Profile of images and scans: a short queue, since each message is large and a late one is of little use."""
STATE = _profile(10)
"""Profile of odometry, joint states, diagnostics and scene states."""
TF = _profile(100)
CLOCK = _profile(10)
MAX_COMMANDS = 100
"""Maximum length of the queue of commands on one topic; beyond it the oldest is dropped."""
COMMAND = _profile(MAX_COMMANDS)
"""Profile of commands: all are applied, those of a step in the order of arrival, however late the step is."""
TICK_DONE = _profile(100, latched=True)
"""Profile of lockstep reports. Latched: a participant may start before the simulation."""
INPUTS = _profile(100, latched=True)
"""Profile of inputs and digests of a run. Latched, so that a recorder that starts late receives the first ones, too."""
INPUTS_AT = _profile(1000)
"""Profile of inputs with the steps at which they are applied: many may arrive at once."""
RUN_INFO = _profile(16, latched=True)
"""Profile of run information: one message per node."""
LATCHED = _profile(1, latched=True)
"""Profile of scene, static transforms, robot description: late subscribers receive the last message."""


def make_publisher(node: Node, message_type: Any, topic: str, profile: QoSProfile) -> Publisher:
    """Returns a publisher whose QoS the user can override; see ``overridable``.

    Raises:
        ConfigError: a QoS parameter has an invalid value.
    """
    try:
        return node.create_publisher(message_type, topic, **overridable(profile))
    except InvalidParameterTypeException as error:
        raise ConfigError(str(error)) from error
    except RuntimeError as error:
        if "QoS override" not in str(error):
            raise
        known = "reliability: reliable or best_effort; history: keep_last or keep_all; depth: a whole number"
        raise ConfigError(f"topic {quoted(topic)}: {error}; allowed: {known}") from error


def overridable(profile: QoSProfile) -> dict[str, Any]:
    """Returns keyword arguments of ``create_publisher``: ``node.create_publisher(Image, topic, **overridable(SENSOR))``.

    rclpy writes the overrides of a topic into the given profile, so each publisher gets a copy. Event callbacks for incompatible QoS are off:
    subscribers report it themselves, and the two callbacks of a publisher cost 0.04 ms in each iteration of the executor (70 publishers: 2.9
    instead of 0.4 ms).
    """
    copy = QoSProfile(
        history=profile.history, depth=profile.depth, reliability=profile.reliability, durability=profile.durability
    )  # fmt: skip
    return {
        "qos_profile": copy,
        "qos_overriding_options": QoSOverridingOptions.with_default_policies(),
        "event_callbacks": PublisherEventCallbacks(use_default_callbacks=False),
    }
