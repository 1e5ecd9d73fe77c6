"""Settings that a test requests for its simulation."""

from __future__ import annotations

import json

import pytest

from gibson_sim.errors import ConfigError
from gibson_sim.testing.settings import SimulationSettings


def test_a_test_without_settings_gets_the_flat_in_lockstep_at_full_speed() -> None:
    settings = SimulationSettings.of({})
    physics = settings.physics
    assert (physics.world.scene, physics.world.robot, physics.world.seed) == ("flat", "gibson_bot", 0)
    assert (physics.sync.lockstep, physics.time.rate) == (True, 0.0)
    assert physics.sync.participants == "simulation_test"
    assert settings.render is None


def test_without_lockstep_time_passes_as_on_a_wall_clock() -> None:
    physics = SimulationSettings.of({"lockstep": False}).physics
    assert (physics.sync.lockstep, physics.time.rate, physics.sync.participants) == (False, 1.0, "")


def test_time_waits_for_renderer_and_recorder_of_a_test() -> None:
    settings = SimulationSettings.of({"cameras": True, "record": True, "detail_px": 2.0})
    assert settings.physics.sync.participants == "simulation_test; render; record"
    assert settings.render is not None and settings.render.detail_px == 2.0


def test_contacts_are_reported_at_every_tick() -> None:
    assert SimulationSettings.of({"publish_hz": 40}).physics.topics.contacts_rate == 40.0
    assert SimulationSettings.of({"contacts_rate": 10.0}).physics.topics.contacts_rate == 10.0


def test_a_given_rate_is_kept_for_programs() -> None:
    assert SimulationSettings.of({"rate": 2.0}).has_rate
    assert not SimulationSettings.of({"seed": 1}).has_rate


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"scne": "flat"}, "simulation setting 'scne' is unknown; did you mean 'scene'?"),
        ({"cameras": "yes"}, "simulation setting 'cameras' is 'yes', must be True or False"),
        ({"seed": -1}, "setting 'seed' is -1"),
        ({"detail_px": 1.0}, "simulation setting 'detail_px' is given without cameras=True"),
        ({"participants": "nav=cmd_vel after odom"}, 'sim.start([...], answers="cmd_vel after scan")'),
        ({"digests": False}, "simulation setting 'digests' is unknown"),
    ],
)
def test_a_setting_that_is_not_allowed_is_named(given: dict[str, object], said: str) -> None:
    with pytest.raises(ConfigError) as error:
        SimulationSettings.of(given)
    assert said in str(error.value)
    assert "\n" not in str(error.value)


def test_robots_have_their_names_and_namespaces() -> None:
    one, two = SimulationSettings.of({}), SimulationSettings.of({"robot": "left=gibson_bot, right=husky"})
    assert (one.robots, one.namespace("robot")) == (("robot",), "")
    assert (two.robots, two.namespace("right")) == (("left", "right"), "right/")


def test_the_process_of_the_simulation_gets_all_settings() -> None:
    values = json.loads(SimulationSettings.of({"cameras": True, "seed": 7}).to_text())
    assert values["nodes"]["physics"]["seed"] == 7
    assert values["nodes"]["render"]["digests"] is True
