"""The folder of a snapshot that got no image."""

from __future__ import annotations

from pathlib import Path

import pytest

from support.simulation import require

require("rclpy", "gibson_msgs")

from gibson_sim.ros.nodes.snapshot_node import remove_empty  # noqa: E402

pytestmark = pytest.mark.ros


def test_folders_without_an_image_are_removed_up_to_one_that_holds_anything(tmp_path: Path) -> None:
    (tmp_path / "a/b/c").mkdir(parents=True)
    (tmp_path / "a/note").touch()
    remove_empty([tmp_path / "a/b/c", tmp_path / "a/b", tmp_path / "a"])
    assert [path.name for path in tmp_path.rglob("*")] == ["a", "note"]


def test_a_folder_with_an_image_stays(tmp_path: Path) -> None:
    (tmp_path / "camera_rgb.png").touch()
    remove_empty([tmp_path])
    assert (tmp_path / "camera_rgb.png").exists()
