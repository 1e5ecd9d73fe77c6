"""Names, namespaces and info of entities."""

from __future__ import annotations

import pytest

from gibson_sim.standard.codes import Result, SimulationError, SpawnCode, shortened
from gibson_sim.standard.entities import (
    Category,
    EntityInfo,
    check_info,
    check_namespace,
    choose_name,
    initial_info,
    is_name,
    usable_name,
)
from support.yard import box


@pytest.mark.parametrize(
    ("wanted", "in_file", "renaming", "name"),
    [
        ("chair", "seat", False, "chair"),
        ("", "seat", False, "seat"),
        ("", "", True, "entity"),
        ("", "004 sugar-box", True, "entity_004_sugar_box"),
        ("taken", "", True, "taken_3"),
        ("", "taken", True, "taken_3"),
    ],
)
def test_name_is_the_requested_one_or_the_files_or_made_up(wanted: str, in_file: str, renaming: bool, name: str) -> None:
    assert choose_name(wanted, in_file, renaming, {"taken", "taken_2"}) == name


@pytest.mark.parametrize(
    ("wanted", "in_file", "renaming", "code"),
    [
        ("", "", False, SpawnCode.NAME_INVALID),
        ("", "a b", False, SpawnCode.NAME_INVALID),
        ("a/b", "", True, SpawnCode.NAME_INVALID),
        ("..", "", True, SpawnCode.NAME_INVALID),
        ("1st", "", False, SpawnCode.NAME_INVALID),
        ("stuhl_\u00e4", "", False, SpawnCode.NAME_INVALID),
        ("a\n", "", False, SpawnCode.NAME_INVALID),
        ("x" * 256, "", False, SpawnCode.NAME_INVALID),
        ("taken", "", False, SpawnCode.NAME_NOT_UNIQUE),
        ("", "taken", False, SpawnCode.NAME_NOT_UNIQUE),
    ],
)
def test_name_that_cannot_be_given_is_refused(wanted: str, in_file: str, renaming: bool, code: SpawnCode) -> None:
    with pytest.raises(SimulationError) as error:
        choose_name(wanted, in_file, renaming, {"taken"})
    assert error.value.code is code


def test_made_up_names_are_valid_however_long_the_request() -> None:
    longest = "x" * 255
    assert is_name(longest)
    assert is_name(choose_name(longest, "", True, {longest}))
    assert is_name(usable_name("\u4e2d" * 1000))
    assert is_name(usable_name("9" * 1000))


@pytest.mark.parametrize("namespace", ["", "/", "left", "/left", "fleet/left_2", "/a/b/c"])
def test_namespaces_of_ros_are_accepted(namespace: str) -> None:
    assert check_namespace(namespace) == namespace


@pytest.mark.parametrize(
    "namespace", ["left/", "//left", "a b", "2nd", "a/2", "a__b", "~left", "{x}", "../a", "a" * 246, "\u00e4"]
)
def test_namespaces_that_ros_refuses_are_refused(namespace: str) -> None:
    with pytest.raises(SimulationError) as error:
        check_namespace(namespace)
    assert error.value.code is SpawnCode.NAMESPACE_INVALID


def test_category_follows_from_mobility_and_class_of_a_body() -> None:
    assert initial_info(box("a", 0.0)).category is Category.DYNAMIC_OBJECT
    assert initial_info(box("a", 0.0, static=True)).category is Category.STATIC_OBJECT
    assert initial_info(box("a", 0.0, semantic_class="Person")) == EntityInfo(Category.HUMAN, "Person", ("Person",))
    assert initial_info(box("a", 0.0, semantic_class="")).tags == ()


@pytest.mark.parametrize(
    "info",
    [EntityInfo(3), EntityInfo(6), EntityInfo(0, "x" * 10_001), EntityInfo(0, "", ("t",) * 101), EntityInfo(0, "", ("t" * 256,))],
)
def test_info_out_of_limits_is_refused(info: EntityInfo) -> None:
    with pytest.raises(SimulationError) as error:
        check_info(info)
    assert error.value.code is Result.OPERATION_FAILED


def test_messages_stay_short_and_on_one_line_whatever_a_client_sends() -> None:
    assert shortened("a\n  b") == "a b"
    for length in (700, 3_000_000):
        text = shortened("a" * length + "\n" + "b" * 400)
        assert len(text) <= 610
        assert "\n" not in text
        assert text.startswith("aaa")
        assert text.endswith("bbb")
