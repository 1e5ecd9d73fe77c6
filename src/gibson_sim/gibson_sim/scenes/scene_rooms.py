"""Reads the list ``rooms`` of a scene.yaml: names, classes and outlines of its rooms."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from gibson_sim.errors import SceneError
from gibson_sim.quoting import quoted
from gibson_sim.scenes.builder import FAR_AWAY, SceneBuilder
from gibson_sim.scenes.room_spec import RoomSpec
from gibson_sim.scenes.yaml_map import YamlMap

_KEYS = ("name", "class", "floor", "polygon")


def read_rooms(builder: SceneBuilder, path: Path, items: list[Any]) -> None:
    """Puts the rooms of a scene.yaml at ``path`` into the builder, which knows its floors already.

    Raises:
        SceneError: a key or a value is wrong.
    """
    floors = len({builder.floor_z, *builder.floors}) if builder.floors else 1
    names: set[str] = set()
    for index, content in enumerate(items):
        item = YamlMap(content, f"{path}: rooms[{index}]", _KEYS)
        room = _room(item, floors)
        if room.name in names:
            raise SceneError(f"{item.where}: name {quoted(room.name)} is used twice; names of rooms must differ")
        names.add(room.name)
        builder.rooms.append(room)


def _room(item: YamlMap, floors: int) -> RoomSpec:
    name, room_class = (item.text(key, "").strip() for key in ("name", "class"))
    for key, text in (("name", name), ("class", room_class)):
        if not text:
            raise SceneError(f"{item.where}: has no {key}; give one, such as kitchen")
    floor = item.value("floor", 0)
    if not isinstance(floor, int) or isinstance(floor, bool) or not 0 <= floor < floors:
        known = "0, the scene has one floor" if floors == 1 else f"a whole number from 0 to {floors - 1}, as floors has it"
        raise SceneError(f"{item.where}: floor is {quoted(floor)}, must be {known}")
    corners = [
        YamlMap({"corner": corner}, f"{item.where}: polygon[{k}]", ("corner",)).floats("corner", 2, -FAR_AWAY, FAR_AWAY)
        for k, corner in enumerate(item.items("polygon"))
    ]
    try:
        return RoomSpec(name, room_class, floor, tuple((x, y) for x, y in corners))
    except SceneError as error:
        raise SceneError(f"{item.where}: {error}") from error
