"""Settings of a test's simulation: ``@pytest.mark.simulation(scene="flat", seed=3, cameras=True)``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gibson_sim.config import PhysicsConfig, RenderConfig, robots_of
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest, setting_fields, setting_values

SCENE = "flat"
"""Default scene: the one that loads fastest."""
PARTICIPANT = "simulation_test"
"""Name of the test's node as a lockstep participant."""
TEST_SETTINGS = {"lockstep": bool, "cameras": bool, "record": bool, "fresh": bool}
"""Settings in addition to those of the nodes, and their types."""
_RESERVED = ("digests", "summary_path", "wait_for", "service_prefix")
"""Settings of the nodes that tests cannot choose."""
_FOREVER_S = 86_400.0
"""Timeout of the participants, seconds of wall time: the test is a participant itself and may stop at a breakpoint."""


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of a simulation for tests."""

    physics: PhysicsConfig
    render: RenderConfig | None
    """Settings of the render node; None = no cameras."""
    lockstep: bool
    """Whether time advances only in calls of the test."""
    has_rate: bool
    """Whether the rate was given and must not be changed for the robot's programs."""
    record: bool
    """Whether to record a bag of the test."""
    fresh: bool
    """Whether to start a simulation for this test only."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> SimulationSettings:
        """Returns the settings for values given by name.

        Raises:
            ConfigError: a name is unknown, or a value is not allowed.
        """
        test_values = {name: kind() for name, kind in TEST_SETTINGS.items()} | {"lockstep": True}
        physics: dict[str, Any] = {"scene": SCENE, "digests": True}
        render: dict[str, Any] = {}
        if "participants" in given:
            raise ConfigError(
                "simulation setting 'participants' would make time wait for programs before the test can start them: give each a rule with "
                'sim.start([...], answers="cmd_vel after scan")'
            )
        names = {
            config: [f.name for f in setting_fields(config) if f.name not in _RESERVED]
            for config in (PhysicsConfig, RenderConfig)
        }
        for name, value in given.items():
            if name in TEST_SETTINGS:
                if not isinstance(value, bool):
                    raise ConfigError(f"simulation setting {quoted(name)} is {quoted(value)}, must be True or False")
                test_values[name] = value
            elif name in names[PhysicsConfig]:
                physics[name] = value
            elif name in names[RenderConfig]:
                render[name] = value
            else:
                known = [*TEST_SETTINGS, *names[PhysicsConfig], *names[RenderConfig]]
                hint = nearest(name, known)
                raise ConfigError(
                    f"simulation setting {quoted(name)} is unknown{f'; {hint}' if hint else ''}; see `gibson-sim params` for all"
                )
        if render and not test_values["cameras"]:
            raise ConfigError(
                f"simulation setting {quoted(next(iter(render)))} is given without cameras=True: add cameras=True, or leave the setting out"
            )
        if test_values["lockstep"]:
            participants = [PARTICIPANT] + ["render"] * test_values["cameras"] + ["record"] * test_values["record"]
            physics["participants"] = "; ".join(participants)
            physics.setdefault("participant_timeout", _FOREVER_S)
        physics["lockstep"] = test_values["lockstep"]
        physics.setdefault("rate", 0.0 if test_values["lockstep"] else 1.0)
        config = PhysicsConfig.of(**physics)
        if "contacts_rate" not in physics:
            config = PhysicsConfig.of(**physics, contacts_rate=float(config.time.publish_hz))
        return cls(
            config, RenderConfig(**render, digests=True) if test_values["cameras"] else None, test_values["lockstep"], "rate" in given,
            test_values["record"], test_values["fresh"],
        )  # fmt: skip

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of the robots; a single robot is ``robot``."""
        return tuple(name or "robot" for name, _ in robots_of(self.physics.world.robot))

    def namespace(self, robot: str) -> str:
        """Returns the namespace of a robot's topics with a trailing slash; empty for a single robot."""
        return f"{robot}/" if "=" in self.physics.world.robot else ""

    def to_text(self) -> str:
        """Returns the settings for the process of the simulation as JSON."""
        nodes: dict[str, Any] = {"physics": self.physics, **({"render": self.render} if self.render is not None else {})}
        values = {name: setting_values(config) for name, config in nodes.items()}
        return json.dumps({"nodes": values, "record": self.record})
