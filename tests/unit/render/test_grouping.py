"""Cached results for cameras: which of them share a target, and others."""

from __future__ import annotations

import gc

import pytest

from gibson_sim.render.draw import grouping
from gibson_sim.render.draw.grouping import CameraGrouping, IdentityCache
from gibson_sim.types import CameraSpec, Output


def _camera(name: str, *outputs: Output, width: int = 64, samples: int = 1, link: str = "robot/base") -> CameraSpec:
    return CameraSpec(name, link, width=width, height=48, outputs=outputs, samples=samples)


def test_cameras_share_a_target_where_the_same_is_drawn_for_them() -> None:
    cameras = [
        _camera("a", "rgb"), _camera("b", "rgb", "depth"), _camera("c", "depth"), _camera("d", "semantic"),
        _camera("e", "rgb", samples=4), _camera("f", "rgb", link=""),
    ]  # fmt: skip
    groups = CameraGrouping(4096).of(cameras)
    assert [group.numbers for group in groups] == [(0, 1, 5), (2,), (3,), (4,)]
    assert [group.features for group in groups] == [(), (), ("LABELS",), ()]
    assert (groups[0].width, groups[0].height, groups[0].places) == (128, 96, ((0, 0), (64, 0), (0, 48)))


def test_without_sharing_every_camera_has_a_target_of_its_own() -> None:
    groups = CameraGrouping(4096, share=False).of([_camera(name, "rgb") for name in "abc"])
    assert [(group.numbers, group.width, group.height, group.places) for group in groups] == [
        ((k,), 64, 48, ((0, 0),)) for k in range(3)
    ]


def test_cameras_that_do_not_fit_into_one_target_get_several() -> None:
    groups = CameraGrouping(100).of([_camera(name, "rgb", width=80) for name in "abc"])
    assert sorted(k for group in groups for k in group.numbers) == [0, 1, 2]
    assert all(group.width <= 100 and group.height <= 100 for group in groups)


def test_equal_cameras_are_grouped_once_and_others_again() -> None:
    grouping = CameraGrouping(4096)
    one, other = _camera("a", "rgb"), _camera("b", "depth")
    assert grouping.of([one, other]) is grouping.of((one, other))
    assert [group.numbers for group in grouping.of([other])] == [(0,)]
    assert [group.features for group in grouping.of([_camera("a", "semantic")])] == [("LABELS",)]


def test_a_result_is_never_that_of_a_freed_object(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grouping, "_MAX_ENTRIES", 8)
    asked = []

    def width(camera: CameraSpec) -> int:
        asked.append(camera.name)
        return camera.width

    remembered = IdentityCache(width)
    for k in range(1, 50):  # cameras are freed, and Python reuses their addresses
        assert remembered(_camera("gone", "rgb", width=k)) == k
        gc.collect(0)
    stays = _camera("stays", "rgb", width=7)
    assert [remembered(stays), remembered(stays)] == [7, 7]
    assert asked.count("stays") == 1
