"""Fixtures of several folders of unit tests."""

from __future__ import annotations

from collections.abc import Callable, Iterator
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


@pytest.fixture
def feed(context: Any) -> Iterator[Callable[..., Any]]:
    """Makes a ``FedNode`` of a class of nodes and parameters, which is closed after the test."""
    from support.fed_node import FedNode

    made: list[FedNode] = []

    def make(kind: type[Any], **parameters: Any) -> FedNode:
        made.append(FedNode(kind, context, **parameters))
        return made[-1]

    yield make
    for fed in made:
        fed.close()
