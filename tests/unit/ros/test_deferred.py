"""Answers that come later."""

from __future__ import annotations

from support.simulation import require

require("rclpy")

import pytest  # noqa: E402

from gibson_sim.ros.services.deferred import DeferredResponse  # noqa: E402

pytestmark = pytest.mark.ros


def test_answer_is_sent_once_whichever_comes_first() -> None:
    for answer_first in (True, False):
        later, sent = DeferredResponse(), []
        if answer_first:
            later.answer("yes")
            later.send_with(sent.append)
        else:
            later.send_with(sent.append)
            assert sent == []
            later.answer("yes")
        assert sent == ["yes"]
