"""Lights made in Python have the limits of those in a scene.yaml."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import gibson_sim as gs

LIGHT = gs.LightSpec()
LAMP = gs.PointLight((1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("light", "changes", "error"),
    [
        (LIGHT, {"sun": -0.1}, "light: sun is -0.1, must be a finite number, 0 or more"),
        (LIGHT, {"ambient": math.nan}, "light: ambient is nan, must be a finite number, 0 or more"),
        (LIGHT, {"sun": "1"}, "light: sun is '1', must be a finite number"),
        (LIGHT, {"environment_yaw": math.inf}, "light: environment_yaw is inf, must be a finite number$"),
        (
            LIGHT,
            {"background": (0.0, 0.0, 1.1)},
            r"light: background is \(0.0, 0.0, 1.1\), must be three finite numbers from 0 to 1",
        ),
        (LIGHT, {"sun_color": (1.0, 1.0)}, "light: sun_color is .*, must be three finite numbers"),
        (LIGHT, {"sun_color": 1.0}, "light: sun_color is 1.0, must be three finite numbers"),
        (LIGHT, {"sun_direction": (0.0, 0.0, 0.0)}, "light: sun_direction is .*, must not be zero"),
        (LIGHT, {"points": ((1.0, 2.0, 3.0),)}, r"light: points\[0\] is .*, must be a PointLight"),
        (LAMP, {"position": (0.0, math.nan, 0.0)}, "point light: position is .*, must be three finite numbers$"),
        (LAMP, {"color": (255, 255, 255)}, "point light: color is .*, must be three finite numbers from 0 to 1"),
        (LAMP, {"strength": -1.0}, "point light: strength is -1.0, must be a finite number, 0 or more"),
        (LAMP, {"range": True}, "point light: range is True, must be a finite number"),
        (LAMP, {"attenuation": (0.0, 0.0, 0.0)}, "one of the three must be above 0"),
        (LAMP, {"direction": (0.0, 0.0, 0.0)}, "point light: direction is .*, must not be zero"),
        (LAMP, {"outer_angle": 4.0}, "point light: outer_angle is 4.0, must be a finite number from 0 to 3.14159"),
        (LAMP, {"inner_angle": 0.5, "outer_angle": 0.4}, "inner_angle is 0.5 rad, must be at most outer_angle, which is 0.4 rad"),
    ],
)
def test_impossible_lights_are_refused_in_one_line(light: Any, changes: dict[str, Any], error: str) -> None:
    with pytest.raises(gs.ConfigError, match=error) as found:
        replace(light, **changes)
    assert "\n" not in str(found.value)


def test_whole_numbers_and_those_of_numpy_are_numbers() -> None:
    assert replace(LIGHT, sun=np.float32(0.5), ambient=1).sun == 0.5
    assert replace(LAMP, color=(1, 0, 0), outer_angle=math.pi, inner_angle=math.pi).color == (1, 0, 0)
