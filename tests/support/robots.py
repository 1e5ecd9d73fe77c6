"""Robots for tests, made from ours, so that what is tested is what users get."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

GIBSON_BOT = Path(__file__).resolve().parents[2] / "config" / "robots" / "gibson_bot" / "robot.yaml"


def write_gibson_bot(folder: Path, *, camera: dict[str, Any] | None = None, **sections: Any) -> Path:
    """Writes gibson_bot with changes and returns the folder.

    Args:
        folder: where to.
        camera: keys of its camera that are other than in its file.
        sections: whole sections that are other, e.g. ``imu={...}``.
    """
    robot = yaml.safe_load(GIBSON_BOT.read_text(encoding="utf-8"))
    robot["urdf"] = str((GIBSON_BOT.parent / robot["urdf"]).resolve())
    robot["cameras"][0].update(camera or {})
    robot.update(sections)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "robot.yaml").write_text(yaml.safe_dump(robot, sort_keys=False), encoding="utf-8")
    return folder
