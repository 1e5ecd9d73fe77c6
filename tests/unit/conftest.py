"""Fixtures of several folders of unit tests."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest


@pytest.fixture
def context(ros_domain: int) -> Iterator[Any]:
    """A ROS context of its own for the nodes of one test."""
    import rclpy

    context = rclpy.Context()
    context.init(domain_id=ros_domain)
    yield context
    context.try_shutdown()
