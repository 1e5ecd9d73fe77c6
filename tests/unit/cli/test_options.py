"""Options from settings, and settings to node arguments."""

from __future__ import annotations

import argparse

import pytest
import yaml

from gibson_sim.cli.commands import replay
from gibson_sim.cli.commands.params import markdown
from gibson_sim.cli.options import add_settings, settings_from_args
from gibson_sim.config import PhysicsConfig
from gibson_sim.errors import ConfigError
from gibson_sim.processes.node_process import node_arguments


def _parse(*argv: str) -> argparse.Namespace:
    parser = argparse.ArgumentParser()
    add_settings(parser, PhysicsConfig, ("scene", "rate", "step_hz", "publish_map_tf"))
    return parser.parse_args(argv)


def test_options_not_given_keep_the_defaults() -> None:
    assert settings_from_args(PhysicsConfig, _parse()) == PhysicsConfig()


def test_options_reach_the_settings_with_their_types() -> None:
    config = settings_from_args(PhysicsConfig, _parse("--scene", "flat", "--rate", "max", "--step-hz", "480", "--publish-map-tf"))
    assert (config.world.scene, config.time.rate, config.time.step_hz, config.topics.publish_map_tf) == ("flat", 0.0, 480, True)


def test_invalid_option_fails_with_the_message_of_the_settings() -> None:
    with pytest.raises(ConfigError, match="setting 'step_hz' is 7, must be 60 to 10000 Hz"):
        settings_from_args(PhysicsConfig, _parse("--step-hz", "7"))


@pytest.mark.parametrize("scene", ["flat", "", "a b", "1.0", "yes", "quote'\"\\", "ä: [x]"])
def test_node_arguments_carry_any_text_as_text(scene: str) -> None:
    config = PhysicsConfig.of(scene=scene)
    arguments = node_arguments(config)
    values = dict(a.split(":=", 1) for a in arguments if ":=" in a)
    assert PhysicsConfig.of(**{name: yaml.safe_load(text) for name, text in values.items()}) == config


def test_parameter_table_has_a_row_for_every_setting() -> None:
    text = markdown()
    assert "| `step_hz` | int | `240` | 60 to 10000 Hz | Physics steps per second of simulation time |" in text


def test_help_describes_each_value() -> None:
    parser = argparse.ArgumentParser()
    add_settings(parser, PhysicsConfig, ("scene", "start", "step_hz", "duration", "map", "seed", "rate", "publish_map_tf"))
    text = " ".join(parser.format_help().split())
    for shown in (
        "--scene NAME|FILE",
        "--start NAME|X,Y,DEG",
        "--step-hz HZ",
        "--duration SECONDS",
        "--map {auto,on,off}",
        "--seed N",
        "--rate FACTOR",
    ):
        assert shown in text
    assert "(default: linden_flat)" in text and "(default: '')" not in text and "default: False" not in text


def test_help_of_a_replay_names_the_values_of_the_bag_as_defaults() -> None:
    parsers = argparse.ArgumentParser().add_subparsers()
    replay.add_parser(parsers)
    text = " ".join(parsers.choices["replay"].format_help().split())
    for wrong in ("linden_flat", "gibson_bot)", "(default: 1)", "(default: 0)", "libEGL.so.1"):
        assert wrong not in text
    assert text.count("(default: that of the bag)") == len((*replay._PHYSICS, *replay._RENDER))
