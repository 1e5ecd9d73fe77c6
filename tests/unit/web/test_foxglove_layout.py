"""The layout file for Foxglove: panels that exist, with settings that they have, each shown once."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from support.simulation import require

require("foxglove")

from foxglove import layouts  # noqa: E402

CONFIGS = {
    "3D": layouts.ThreeDeeConfig,
    "CallService": layouts.ServiceCallConfig,
    "DiagnosticSummary": layouts.DiagnosticsSummaryConfig,
    "Image": layouts.ImageConfig,
    "Plot": layouts.PlotConfig,
    "Teleop": layouts.TeleopConfig,
}
"""Type of panel -> the SDK's model of its settings."""
INNER = {
    "cameraState": layouts.ThreeDeeCameraState,
    "imageMode": layouts.ImageModeConfig,
    "publish": layouts.ThreeDeePublishSettings,
    "scene": layouts.BaseRendererSceneSettings,
    "upButton": layouts.TeleopButton,
}


@pytest.fixture(scope="module")
def layout(root: Path) -> dict[str, Any]:
    document: dict[str, Any] = json.loads((root / "config" / "foxglove_layout.json").read_text())
    return document


def _keys(model: Any) -> set[str]:
    return set(model()._to_dict())


def test_settings_of_every_panel_exist(layout: dict[str, Any]) -> None:
    for name, config in layout["configById"].items():
        kind = name.partition("!")[0]
        if kind == "Parameters":
            assert config == {}
            continue
        assert set(config) <= _keys(CONFIGS[kind]), name
        for key, values in config.items():
            if key in INNER:
                assert set(values) <= _keys(INNER[key]), f"{name}: {key}"
        for series in config.get("paths", ()):
            assert set(series) <= _keys(layouts.PlotSeries)


def test_settings_of_topics_are_those_of_their_types(layout: dict[str, Any]) -> None:
    kinds = {
        "/map": layouts.BaseRendererRosOccupancyGridTopicSettings, "/scan": layouts.BaseRendererLaserScanTopicSettings,
        "/robot_description": layouts.BaseRendererUrdfTopicSettings, "/plan": layouts.BaseRendererPosesTopicSettings,
        "/amcl_pose": layouts.BaseRendererPoseTopicSettings, "/camera/depth/points": layouts.BaseRendererPointCloudTopicSettings,
        "/global_costmap/costmap": layouts.BaseRendererRosOccupancyGridTopicSettings,
        "/local_costmap/costmap": layouts.BaseRendererRosOccupancyGridTopicSettings,
    }  # fmt: skip
    found = {topic: values for config in layout["configById"].values() for topic, values in config.get("topics", {}).items()}
    assert set(found) == set(kinds)
    for topic, values in found.items():
        assert set(values) <= _keys(kinds[topic]), topic


def test_every_panel_is_shown_once(layout: dict[str, Any]) -> None:
    def leaves(part: Any) -> list[str]:
        return [part] if isinstance(part, str) else leaves(part["first"]) + leaves(part["second"])

    assert sorted(leaves(layout["layout"])) == sorted(layout["configById"])
    kinds = [name.partition("!")[0] for name in layout["configById"]]
    assert {"Image", "3D", "Plot", "Teleop", "DiagnosticSummary"} <= set(kinds)
    assert kinds.count("3D") == 2, "the scene, and the map from above"
