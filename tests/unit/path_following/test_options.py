"""Parameters of the nodes: limits, and that each says what it is."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import pytest

from gibson_path_following.errors import SettingError
from gibson_path_following.options import EvaluatorOptions, LocaliserOptions, Options, PolicyOptions, RecorderOptions

KINDS = (RecorderOptions, LocaliserOptions, PolicyOptions, EvaluatorOptions)


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
        (PolicyOptions, {"path": "p", "max_linear": "fast"}, "max_linear is 'fast', must be of type float"),
        (PolicyOptions, {"path": "p", "image_topics": "camera"}, "must be a list of names"),
        (RecorderOptions, {"camera": "radar"}, "camera is 'radar', must be one of pinhole, fisheye_pair"),
        (RecorderOptions, {"camera": "fisheye_pair"}, "image_topics has 1 names, a fisheye_pair camera needs 2: front, back"),
        (RecorderOptions, {"width": 4}, "width is 4, must be 16 to 4096"),
        (EvaluatorOptions, {"path": "p", "file": "a.txt"}, "must be a name that ends in .json"),
    ],
)
def test_values_that_are_not_allowed_are_one_line(kind: type[Options], values: dict[str, Any], part: str) -> None:
    with pytest.raises(SettingError, match=part):
        kind(**values)
