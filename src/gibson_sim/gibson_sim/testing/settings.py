"""What a test asks of its simulation: ``@pytest.mark.simulation(scene="flat", seed=3, cameras=True)``."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any

from gibson_sim.config import PhysicsConfig, RenderConfig
from gibson_sim.errors import ConfigError
from gibson_sim.quoting import quoted
from gibson_sim.settings import nearest

SCENE = "flat"
"""Scene of a test that names none: the one that loads most quickly."""
PARTICIPANT = "simulation_test"
"""Name of the test's node, which takes part in lockstep."""
OWN = {"lockstep": bool, "cameras": bool, "record": bool, "fresh": bool}
"""Settings besides those of the nodes, and their types."""
_OURS = ("digests", "summary_path", "wait_for", "service_prefix")
"""Settings of the nodes that tests cannot choose."""
_FOREVER_S = 86_400.0
"""The test is a participant itself, and may stand at a breakpoint, seconds of wall time."""


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of a simulation for tests."""

    physics: PhysicsConfig
    render: RenderConfig | None
    """None = no cameras."""
    lockstep: bool
    """Time passes only while the test lets it."""
    has_rate: bool
    """The rate was given, and is not to be changed for the robot's programs."""
    record: bool
    """Record a bag of the test."""
    fresh: bool
    """Start a simulation for this test alone."""

    @classmethod
    def of(cls, given: Mapping[str, Any]) -> SimulationSettings:
        """Returns the settings that a test gave by name.

        Raises:
            ConfigError: a name is unknown, or a value is not allowed.
        """
        own = {name: kind() for name, kind in OWN.items()} | {"lockstep": True}
        physics: dict[str, Any] = {"scene": SCENE, "digests": True}
        render: dict[str, Any] = {}
        if "participants" in given:
            raise ConfigError(
                "simulation setting 'participants' would have time wait for programs before the test can start them: give each its rule by "
                'sim.start([...], answers="cmd_vel after scan")'
            )
        names = {config: [f.name for f in fields(config) if f.name not in _OURS] for config in (PhysicsConfig, RenderConfig)}
        for name, value in given.items():
            if name in OWN:
                if not isinstance(value, bool):
                    raise ConfigError(f"simulation setting {quoted(name)} is {quoted(value)}, must be True or False")
                own[name] = value
            elif name in names[PhysicsConfig]:
                physics[name] = value
            elif name in names[RenderConfig]:
                render[name] = value
            else:
                known = [*OWN, *names[PhysicsConfig], *names[RenderConfig]]
                hint = nearest(name, known)
                raise ConfigError(
                    f"simulation setting {quoted(name)} is unknown{f'; {hint}' if hint else ''}; see `gibson-sim params` for all"
                )
        if render and not own["cameras"]:
            raise ConfigError(
                f"simulation setting {quoted(next(iter(render)))} is given without cameras=True: add that, or leave it out"
            )
        if own["lockstep"]:
            ours = [PARTICIPANT] + ["render"] * own["cameras"] + ["record"] * own["record"]
            physics["participants"] = "; ".join(ours)
            physics.setdefault("participant_timeout", _FOREVER_S)
        physics["lockstep"] = own["lockstep"]
        physics.setdefault("rate", 0.0 if own["lockstep"] else 1.0)
        config = PhysicsConfig(**physics)
        if "contacts_rate" not in physics:
            config = PhysicsConfig(**physics, contacts_rate=float(config.publish_hz))
        return cls(
            config, RenderConfig(**render, digests=True) if own["cameras"] else None, own["lockstep"], "rate" in given,
            own["record"], own["fresh"],
        )  # fmt: skip

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of the robots; a single robot is ``robot``."""
        entries = self.physics.robot.split(",")
        return tuple(entry.partition("=")[0].strip() for entry in entries) if "=" in self.physics.robot else ("robot",)

    def namespace(self, robot: str) -> str:
        """Returns the namespace of a robot's topics, with a slash at its end; empty for a single robot."""
        return f"{robot}/" if "=" in self.physics.robot else ""

    def to_text(self) -> str:
        """Returns all that the process of the simulation needs, as JSON."""
        nodes: dict[str, Any] = {"physics": self.physics, **({"render": self.render} if self.render is not None else {})}
        values = {name: {f.name: getattr(config, f.name) for f in fields(config)} for name, config in nodes.items()}
        return json.dumps({"nodes": values, "record": self.record})
