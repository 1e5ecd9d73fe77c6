"""Parameters of the nodes: limits, and that each says what it is."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.options import (
    EvaluatorOptions,
    FaultOptions,
    GogglesOptions,
    LocaliserOptions,
    Options,
    PolicyOptions,
    RecorderOptions,
    check_start,
    describe,
    unknown_name,
)  # fmt: skip

KINDS = (RecorderOptions, LocaliserOptions, PolicyOptions, EvaluatorOptions, FaultOptions, GogglesOptions)


@pytest.mark.parametrize("kind", KINDS)
def test_every_parameter_has_a_description_and_every_number_limits(kind: type[Options]) -> None:
    assert [one.name for one in fields(kind) if len(one.metadata["text"]) < 10] == []
    numbers = [one for one in fields(kind) if isinstance(one.default, (int, float)) and not isinstance(one.default, bool)]
    assert [one.name for one in numbers if not one.metadata["least"] <= one.default <= one.metadata["most"]] == []


@pytest.mark.parametrize(
    ("kind", "values", "part"),
    [
        (PolicyOptions, {}, "parameter path is empty"),
        (PolicyOptions, {"path": "p", "max_linear": 20.0}, "max_linear is 20, must be 0.01 to 10"),
        (PolicyOptions, {"path": "p", "max_linear": "fast"}, "max_linear is 'fast', must be a number"),
        (PolicyOptions, {"path": "p", "search": 1}, "search is 1, must be true or false"),
        (PolicyOptions, {"path": 5}, "path is 5, must be text"),
        (PolicyOptions, {"path": "p", "image_topics": "camera"}, "must be a list of names"),
        (
            PolicyOptions,
            {"path": "p", "image_topics": None},
            r"image_topics is empty, must be a list of names, such as \[camera/image_raw\]",
        ),
        (
            PolicyOptions,
            {"path": "p", "image_topics": ["bad name"]},
            "image_topics is 'bad name', which cannot name a topic; must be letters",
        ),
        (EvaluatorOptions, {"path": "p", "collision_topic": "a//b"}, "collision_topic is 'a//b', which cannot name a topic"),
        (GogglesOptions, {"image_topic": "1/image"}, "image_topic is '1/image', which cannot name a topic"),
        (GogglesOptions, {"image_topic": "front/camera_info"}, "image_topic has 'front/camera_info', must be topics of images"),
        (RecorderOptions, {"image_topics": ["camera_info"]}, "image_topics has 'camera_info', must be topics of images, such as"),
        (RecorderOptions, {"camera_hfov_deg": 180.0}, "camera_hfov_deg is 180, must be 0, or 1 to 179 for a pinhole camera"),
        (RecorderOptions, {"hfov_deg": 200.0}, "hfov_deg is 200, must be 0, or 1 to 179 for a pinhole camera"),
        (
            RecorderOptions,
            {"camera": "fisheye_pair", "image_topics": ["a", "a"]},
            r"image_topics is \['a', 'a'\], must be different topics: front, back",
        ),
        (RecorderOptions, {"camera": "radar"}, "camera is 'radar', must be one of pinhole, fisheye_pair"),
        (RecorderOptions, {"camera": "fisheye_pair"}, "image_topics has 1 names, a fisheye_pair camera needs 2: front, back"),
        (RecorderOptions, {"width": 4}, "width is 4, must be 16 to 4096"),
        (EvaluatorOptions, {"path": "p", "file": "a.txt"}, "must be a name that ends in .json"),
    ],
)
def test_values_that_are_not_allowed_are_one_line(kind: type[Options], values: dict[str, Any], part: str) -> None:
    with pytest.raises(SettingError, match=part):
        kind(**values)


def test_names_of_topics_and_a_fisheyes_field_of_view_are_accepted() -> None:
    RecorderOptions(camera="fisheye_pair", image_topics=["/a_1/b", "~/c"], hfov_deg=200.0, camera_hfov_deg=190.0)
    EvaluatorOptions(path="p", collision_topic="")


@pytest.mark.parametrize("start", [-0.5, 12.0])
def test_a_start_that_is_no_node_is_refused(start: float) -> None:
    with pytest.raises(SettingError, match=r"must be -1 = anywhere, or a node of the path, 0 to 11"):
        check_start(start, 12)


@pytest.mark.parametrize("kind", KINDS)
def test_every_parameter_is_described_with_its_default(kind: type[Options]) -> None:
    lines = describe(kind).splitlines()
    assert [line.split()[0] for line in lines if line.startswith("  ") and line[2] != " "] == [one.name for one in fields(kind)]
    assert max(map(len, lines)) <= 100


def test_a_description_has_type_limits_and_default() -> None:
    text = describe(PolicyOptions)
    assert "  max_linear  (float, 0.01 to 10; default 0.5)\n      maximum speed, m/s\n" in text
    assert "  image_topics  (list of strings; default [camera/image_raw])\n" in text
    assert "  path  (string; default empty)\n" in text and "  search  (bool; default true)\n" in text


@pytest.mark.parametrize(
    ("name", "hint"),
    [("mod", "did you mean 'mode'?"), ("modle", "did you mean 'model'?"), ("zzz", "--help lists the parameters of this node")],
)
def test_an_unknown_parameter_gets_a_hint(name: str, hint: str) -> None:
    assert unknown_name(name, GogglesOptions) == f"parameter '{name}' is unknown and has no effect; {hint}"
