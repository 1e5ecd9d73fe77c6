"""Settings: defaults, limits and error messages in one place."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path

import pytest
import yaml

from gibson_sim.client_config import NODE_CONFIGS, RecordConfig
from gibson_sim.config import PhysicsConfig, parse_fill, robots_of
from gibson_sim.errors import ConfigError
from gibson_sim.settings import make_settings, parts_of, setting_fields, setting_values
from gibson_sim.types import CameraSpec


@pytest.mark.parametrize("name", NODE_CONFIGS)
def test_defaults_are_allowed_and_every_setting_says_what_it_means(name: str) -> None:
    config = NODE_CONFIGS[name]()
    assert all(len(f.metadata["doc"]) > 15 for f in setting_fields(type(config)))


def test_value_beyond_its_limits_names_setting_value_and_limits() -> None:
    with pytest.raises(ConfigError, match="setting 'step_hz' is 10, must be 60 to 10000 Hz"):
        PhysicsConfig.of(step_hz=10)


def test_nan_is_not_within_limits() -> None:
    with pytest.raises(ConfigError, match="'rate' is nan"):
        PhysicsConfig.of(rate=float("nan"))


def test_text_where_a_number_belongs_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"'rate' is 'fast' \(str\), must be of type float"):
        PhysicsConfig.of(rate="fast")  # type: ignore[arg-type]


def test_whole_number_is_taken_where_a_float_belongs() -> None:
    assert PhysicsConfig.of(rate=2).time.rate == 2.0


def test_unknown_choice_is_refused_with_the_choices() -> None:
    with pytest.raises(ConfigError, match="must be one of none, zstd, lz4"):
        RecordConfig(compression="gzip")


def test_rates_that_do_not_divide_are_refused() -> None:
    with pytest.raises(ConfigError, match="'publish_hz' is 50 Hz, must divide 'step_hz', which is 240 Hz"):
        PhysicsConfig.of(publish_hz=50)


def test_clock_may_have_any_rate_up_to_that_of_the_steps() -> None:
    assert PhysicsConfig.of(clock_hz=7).time.clock_hz == 7
    with pytest.raises(ConfigError, match="'clock_hz' is 241 Hz, must be at most 'step_hz', 240 Hz"):
        PhysicsConfig.of(clock_hz=241)


def test_camera_outputs_come_in_the_order_of_the_renderer() -> None:
    assert PhysicsConfig.of(camera_outputs="depth, rgb").cameras.outputs == ("rgb", "depth")
    assert PhysicsConfig().cameras.outputs == ()
    with pytest.raises(ConfigError, match="has smell; must be of rgb, depth, semantic, instance, normal"):
        PhysicsConfig.of(camera_outputs="rgb,smell")


def test_camera_fill_names_what_fills_and_whether_depth_is_filled() -> None:
    assert PhysicsConfig.of(camera_fill="push_pull").cameras.fill == ("push_pull", False)
    assert PhysicsConfig.of(camera_fill="learned,depth").cameras.fill == ("learned", True)
    assert PhysicsConfig.of(camera_fill="none").cameras.fill == ("", False)
    for wrong in ("telea", "learned,colour", "none,depth", ",depth"):
        with pytest.raises(
            ConfigError, match=r"setting 'camera_fill' is .*, must be none, push_pull, learned or the path of an ONNX file"
        ):
            PhysicsConfig.of(camera_fill=wrong)
    with pytest.raises(ConfigError, match=r"'lerned', must be .*; did you mean 'learned'\?"):
        PhysicsConfig.of(camera_fill="lerned")


def test_a_network_that_fills_holes_must_exist(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a, b.onnx").touch()
    assert PhysicsConfig.of(camera_fill="a, b.onnx,depth").cameras.fill == (str(tmp_path / "a, b.onnx"), True)
    with pytest.raises(
        ConfigError, match=r"setting 'camera_fill': there is no file '/.*/gone\.onnx'; give an ONNX file, or push_pull, learned"
    ):
        PhysicsConfig.of(camera_fill="gone.onnx")
    with pytest.raises(ConfigError, match="there is no file"):
        PhysicsConfig.of(camera_fill=f"{'n' * 300}.onnx")


@pytest.mark.parametrize("wrong", [3, True, ["push_pull"]])
def test_a_fill_that_is_no_text_is_refused(wrong: object) -> None:
    with pytest.raises(ConfigError, match=r"fill is .*, must be none, push_pull"):
        parse_fill("fill", wrong)  # type: ignore[arg-type]
    with pytest.raises(ConfigError, match=r"fill is .*, must be push_pull"):
        CameraSpec("camera", "", fill=wrong)  # type: ignore[arg-type]


def test_wait_for_reads_topics_and_counts() -> None:
    assert PhysicsConfig.of(wait_for="scene_state:2,/odom").sync.required_subscribers == {"scene_state": 2, "/odom": 1}
    for wrong in ("odom:", "odom:0", "odom:x", "odom:\u00b2", ":1", "a b:1", "odom:9999999"):
        with pytest.raises(ConfigError, match=r"setting 'wait_for' has '.*', must be TOPIC or TOPIC:N, such as"):
            PhysicsConfig.of(wait_for=wrong)


@pytest.mark.parametrize("node", ["physics", "render"])
def test_shipped_parameter_file_is_allowed_and_equals_the_defaults(root: Path, node: str) -> None:
    text = (root / "config" / f"{node}.param.yaml").read_text()
    values = yaml.safe_load(text)["/**"]["ros__parameters"]
    assert make_settings(NODE_CONFIGS[node], values) == NODE_CONFIGS[node]()


def test_settings_of_all_parts_have_names_of_their_own() -> None:
    names = [f.name for f in setting_fields(PhysicsConfig)]
    assert len(names) == len(set(names)) == sum(len(fields(part)) for part in parts_of(PhysicsConfig).values())
    assert set(names).isdisjoint(parts_of(PhysicsConfig))


def test_values_by_name_go_to_their_parts_and_come_back() -> None:
    config = make_settings(PhysicsConfig, {"step_hz": 120, "lockstep": True, "participants": "nav"})
    assert (config.time.step_hz, config.time.publish_hz, config.sync.participants) == (120, 60, "nav")
    values = setting_values(config)
    assert (values["step_hz"], values["seed"]) == (120, 0)
    assert make_settings(PhysicsConfig, values) == config


def test_an_unknown_name_is_a_mistake_of_the_caller() -> None:
    with pytest.raises(TypeError, match="step_hertz"):
        PhysicsConfig.of(step_hertz=120)


def test_a_limit_between_two_parts_is_checked() -> None:
    with pytest.raises(ConfigError, match="setting 'camera_rate' is 90 Hz, must be at most 'publish_hz', 60 Hz"):
        PhysicsConfig.of(camera_rate=90.0)


@pytest.mark.parametrize(
    ("text", "robots"),
    [
        ("gibson_bot", (("", "gibson_bot"),)),
        ("a/b.urdf", (("", "a/b.urdf"),)),
        ("left=gibson_bot, right = arm_bot", (("left", "gibson_bot"), ("right", "arm_bot"))),
    ],
)
def test_robots_of_a_setting_have_names_where_there_are_several(text: str, robots: tuple[tuple[str, str], ...]) -> None:
    assert robots_of(text) == robots


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (" ", "robot is empty: name one, such as gibson_bot, or give its file"),
        ("a=gibson_bot,b", "robot 'b' must be name=robot where there are several"),
        ("a=gibson_bot,a=arm_bot", "two robots are named 'a'; names must be unique"),
    ],
)
def test_robots_without_distinct_names_are_refused(text: str, said: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(said)):
        robots_of(text)
