"""Deferred responses."""

from __future__ import annotations

from support.simulation import require

require("rclpy")

import pytest  # noqa: E402

from gibson_sim.ros.services.deferred import DeferredResponse  # noqa: E402

pytestmark = pytest.mark.ros


def test_answer_is_sent_once_whichever_comes_first() -> None:
    for answer_first in (True, False):
        deferred, sent = DeferredResponse(), []
        if answer_first:
            deferred.send("yes")
            deferred.bind(sent.append)
        else:
            deferred.bind(sent.append)
            assert sent == []
            deferred.send("yes")
        assert sent == ["yes"]
