"""Settings of the render node that hold lists and pairs."""

from __future__ import annotations

from pathlib import Path

import pytest

from gibson_sim.config import RenderConfig
from gibson_sim.errors import ConfigError


def test_cameras_are_names_separated_by_commas() -> None:
    assert RenderConfig(cameras="left/camera, right/camera").camera_names == ("left/camera", "right/camera")
    assert RenderConfig().camera_names == ()


def test_registrations_are_pairs() -> None:
    assert RenderConfig(register_depth="a=b, c=d").registrations == {"a": "b", "c": "d"}


@pytest.mark.parametrize("text", ["a", "a=", "=b", "a=b,c"])
def test_half_a_pair_is_refused_with_an_example(text: str) -> None:
    with pytest.raises(ConfigError, match=r"'register_depth' has .*must be pairs separated by commas, e\.g\. depth_camera=color"):
        RenderConfig(register_depth=text)


def test_asset_folders_are_pairs(tmp_path: Path) -> None:
    assert RenderConfig(asset_roots=f"/a/b={tmp_path}").asset_folders == (("/a/b", str(tmp_path)),)
