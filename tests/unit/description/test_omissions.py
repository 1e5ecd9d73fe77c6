"""Warnings about what is left out."""

from __future__ import annotations

from gibson_sim.description.omissions import grouped


def test_warnings_that_differ_only_in_the_file_become_one_line() -> None:
    lines = [
        "meshes/a.dae: lines are not drawn",
        "model chair: mesh b.dae does not exist; left out",
        "meshes/b.dae: lines are not drawn",
        "meshes/a.dae: its cameras are left out",
        "meshes/c.dae: lines are not drawn",
        "two of its lights are left out",
    ]
    assert grouped(lines) == [
        "meshes/a.dae and 2 more: lines are not drawn",
        "model chair: mesh b.dae does not exist; left out",
        "meshes/a.dae: its cameras are left out",
        "two of its lights are left out",
    ]


def test_models_with_the_same_warning_become_one_line() -> None:
    lines = ["model chair_1: <emissive> is left out", "model table: its mesh is missing", "model chair_2: <emissive> is left out"]
    assert grouped(lines) == ["model chair_1 and 1 more: <emissive> is left out", "model table: its mesh is missing"]


def test_each_file_counts_once() -> None:
    assert grouped(["a.dae: lines are not drawn"] * 2) == ["a.dae: lines are not drawn"]
