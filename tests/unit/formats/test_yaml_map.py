"""Mappings of YAML files: one-line errors of the requested type, with file and key."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.errors import GibsonSimError, RobotError, SceneError
from gibson_sim.formats.yaml_map import YamlMap, read_yaml_map


@pytest.mark.parametrize("error", [SceneError, RobotError])
def test_errors_of_a_mapping_and_of_those_inside_it_have_its_type(error: type[GibsonSimError]) -> None:
    top = YamlMap({"arm": {"size": "x"}, "list": [{"size": True}]}, "a.yaml", error=error)
    arm = top.section("arm")
    assert arm is not None
    with pytest.raises(error, match=r"a\.yaml: arm: size is 'x', must be a finite number"):
        arm.number("size")
    with pytest.raises(error, match=r"a.yaml: list\[0\]: size is True, must be a finite number"):
        top.within(top.items("list")[0], "list[0]").number("size")


def test_unknown_key_names_a_similar_one_and_all_known_ones() -> None:
    with pytest.raises(SceneError, match=r"f: key 'heigth' is unknown; did you mean 'height'\? known: width, height"):
        YamlMap({"heigth": 1}, "f", ("width", "height"))
    with pytest.raises(SceneError, match="f: key 'q' is unknown; known: width, height"):
        YamlMap({"q": 1}, "f", ("width", "height"))


def test_key_without_a_default_must_be_there() -> None:
    values = YamlMap({"empty": ""}, "f")
    assert values.text("empty", "") == "" and values.number("size", 2.0) == 2.0
    for read in (values.number, values.text):
        with pytest.raises(SceneError, match="f: size is missing"):
            read("size")
    with pytest.raises(SceneError, match="f: empty is '', must be text"):
        values.text("empty")


def test_clients_learn_the_requirement_but_not_the_value() -> None:
    with pytest.raises(SceneError) as caught:
        YamlMap({"size": "secret"}, "f").number("size", low=0.0, high=1.0)
    assert caught.value.public == "size must be a finite number, from 0 to 1"


def test_empty_file_is_an_empty_mapping(tmp_path: Path) -> None:
    (tmp_path / "a.yaml").write_text("# nothing\n")
    assert read_yaml_map(tmp_path / "a.yaml", ("size",)).values == {}
    with pytest.raises(RobotError, match=r"b\.yaml: cannot be read"):
        read_yaml_map(tmp_path / "b.yaml", error=RobotError)
