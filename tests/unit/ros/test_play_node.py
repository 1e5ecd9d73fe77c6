"""The player's terminal."""

from __future__ import annotations

import os
import sys

import pytest

from support.simulation import require

require("rclpy")

from gibson_sim.ros.nodes import play_node  # noqa: E402

pytestmark = pytest.mark.ros


def test_a_terminal_that_is_not_the_controlling_one_has_no_keys(monkeypatch: pytest.MonkeyPatch) -> None:
    master, slave = os.openpty()
    with os.fdopen(master, "wb", buffering=0) as keyboard, os.fdopen(slave) as terminal:
        monkeypatch.setattr(sys, "stdin", terminal)
        with play_node._Keys() as keys:
            keyboard.write(b" \n")
            assert keys.pressed() == ""
