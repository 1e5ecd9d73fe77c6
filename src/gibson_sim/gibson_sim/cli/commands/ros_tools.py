"""``gibson-sim topic``, ``node``, ``service``, ``param``, ``action`` and short verbs: replacements of ``ros2`` commands for machines without it.

They are a subset of ``ros2``: commands and options have the same names and meanings.
"""

from __future__ import annotations

import argparse
import json
from typing import Any

from gibson_sim.cli.environment import add_network, environment_of, require_nodes
from gibson_sim.cli.processes import become

_PLACE = "X,Y or X,Y,YAW on the map, m and degrees"
_HIDDEN = "a part of their name begins with _, as in those of actions"


def add_parser(subparsers: Any) -> None:
    """Adds all sub-commands of this module."""
    _add_topic(
        subparsers.add_parser("topic", help="list, type, info, echo, hz, bw and delay of topics, a subset of `ros2 topic`")
    )
    _add_node(subparsers.add_parser("node", help="list and info of nodes, a subset of `ros2 node`"))
    _add_service(subparsers.add_parser("service", help="list, type and call of services, a subset of `ros2 service`"))
    _add_param(subparsers.add_parser("param", help="list, get and set of parameters, a subset of `ros2 param`"))
    _add_action(subparsers.add_parser("action", help="list and send_goal of actions, a subset of `ros2 action`"))
    _add_verbs(subparsers)


def _add_topic(parser: Any) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    listed = kinds.add_parser("list", help="names of all topics")
    listed.add_argument("-t", "--show-types", dest="types", action="store_true", help="also their types")
    listed.add_argument("--include-hidden-topics", action="store_true", help=f"also hidden topics: {_HIDDEN}")
    _finish(listed, "topic list")
    kind = kinds.add_parser("type", help="type of a topic")
    kind.add_argument("topic")
    _finish(kind, "topic type")
    info = kinds.add_parser("info", help="type of a topic, and how many nodes publish and subscribe")
    info.add_argument("topic")
    info.add_argument("-v", "--verbose", action="store_true", help="also the nodes and their quality of service")
    _finish(info, "topic info")
    echo = kinds.add_parser("echo", help="print messages")
    echo.add_argument("topic")
    echo.add_argument(
        "type", nargs="?", default="", help="type, such as std_msgs/msg/String; needed if no node publishes or subscribes yet"
    )
    echo.add_argument("--once", action="store_true", help="print one message and exit")
    echo.add_argument("--field", default="", metavar="PATH", help="print one field, such as pose.pose.position")
    echo.add_argument("-f", "--full-length", dest="full", action="store_true", help="print arrays and texts to their end")
    _finish(echo, "topic echo")
    for name, text in (
        ("hz", "print the rate"),
        ("bw", "print the bandwidth"),
        ("delay", "print the delay from stamp to arrival"),
    ):
        measure = kinds.add_parser(name, help=f"{text}, once a second")
        measure.add_argument("topic")
        measure.add_argument(
            "--seconds",
            type=_seconds,
            default=0.0,
            metavar="S",
            help="stop after this much wall time; 0 = at Ctrl-C (default: 0)",
        )
        _finish(measure, f"topic {name}")


def _add_node(parser: Any) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    _finish(kinds.add_parser("list", help="names of all nodes"), "node list")
    info = kinds.add_parser("info", help="topics, services and actions of a node")
    info.add_argument("node")
    info.add_argument("--include-hidden", action="store_true", help=f"also hidden topics and services: {_HIDDEN}")
    _finish(info, "node info")


def _add_service(parser: Any) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    listed = kinds.add_parser("list", help="names of all services")
    listed.add_argument("-t", "--show-types", dest="types", action="store_true", help="also their types")
    listed.add_argument("--include-hidden-services", action="store_true", help=f"also hidden services: {_HIDDEN}")
    _finish(listed, "service list")
    kind = kinds.add_parser("type", help="type of a service")
    kind.add_argument("service")
    _finish(kind, "service type")
    call = kinds.add_parser("call", help="call a service")
    call.add_argument("service")
    call.add_argument("type", nargs="?", default="", help="type of the service (default: the one that is offered)")
    call.add_argument("values", nargs="?", default="", metavar="YAML", help='the request, such as "{entity: ball}"')
    _finish(call, "service call")


def _add_param(parser: Any) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    listed = kinds.add_parser("list", help="parameters of a node, or of all")
    listed.add_argument("node", nargs="?")
    _finish(listed, "param list")
    get = kinds.add_parser("get", help="print a parameter")
    get.add_argument("node")
    get.add_argument("name")
    _finish(get, "param get")
    change = kinds.add_parser("set", help="change a parameter of a running node")
    change.add_argument("node")
    change.add_argument("name")
    change.add_argument("value")
    _finish(change, "param set")


def _add_action(parser: Any) -> None:
    kinds = parser.add_subparsers(dest="kind", required=True, metavar="WHAT")
    listed = kinds.add_parser("list", help="names of all actions")
    listed.add_argument("-t", "--show-types", dest="types", action="store_true", help="also their types")
    _finish(listed, "action list")
    send = kinds.add_parser("send_goal", help="send a goal, and wait for its result")
    send.add_argument("action")
    send.add_argument("type", help="type of the action")
    send.add_argument("values", nargs="?", default="", metavar="YAML", help="the goal")
    send.add_argument("-f", "--feedback", action="store_true", help="print the feedback")
    _finish(send, "action send_goal")


class _ListModels(argparse.Action):
    """Prints the names of all built-in models, and exits, as ``--help`` does."""

    def __call__(self, parser: argparse.ArgumentParser, *_: Any) -> None:
        from gibson_sim.scenes.spawnables import built_in_spawnables

        print("\n".join(built_in_spawnables()))
        parser.exit()


def _add_verbs(subparsers: Any) -> None:
    spawn = subparsers.add_parser("spawn", help="spawn an object or a robot of the catalogue in the running simulation")
    spawn.add_argument("uri", metavar="MODEL", help="name or URI, such as bottle_water")
    spawn.add_argument(
        "--list",
        action=_ListModels,
        nargs=0,
        default=argparse.SUPPRESS,  # no argument of the tool
        help="print the names of all built-in models, and exit",
    )
    spawn.add_argument("--at", type=_place, required=True, metavar="X,Y[,YAW]", help=_PLACE)
    spawn.add_argument("--name", default="", help="name of the entity (default: that of the model)")
    _finish(spawn, "spawn")
    move = subparsers.add_parser("move", help="move an entity or a robot to another pose")
    move.add_argument("name", metavar="ENTITY")
    move.add_argument("--at", type=_place, required=True, metavar="X,Y[,YAW]", help=_PLACE)
    _finish(move, "move")
    delete = subparsers.add_parser("delete", help="remove an entity")
    delete.add_argument("name", metavar="ENTITY")
    _finish(delete, "delete")
    for name, text in (("pause", "pause the simulation"), ("play", "resume the simulation"), ("reset", "reset the simulation")):
        _finish(subparsers.add_parser(name, help=text), name)
    step = subparsers.add_parser("step", help="run physics steps of a paused simulation")
    step.add_argument("steps", nargs="?", type=_count, default=1, metavar="N", help="number of steps (default: 1)")
    _finish(step, "step")
    load = subparsers.add_parser("load", help="load another scene into the running simulation")
    load.add_argument("world", metavar="SCENE", help="name or path of a scene")
    _finish(load, "load")
    goal = subparsers.add_parser("goal", help="send a goal to a navigation stack (publishes goal_pose)")
    goal.add_argument("at", type=_place, metavar="X,Y[,YAW]", help=_PLACE)
    _finish(goal, "goal")


def _finish(parser: argparse.ArgumentParser, command: str) -> None:
    """Adds the network options to the parser of a command."""
    given = [action.dest for action in parser._actions if action.default is not argparse.SUPPRESS]
    add_network(parser)
    parser.set_defaults(run=lambda args: _become(args, command, given))


def _become(args: argparse.Namespace, command: str, given: list[str]) -> int:
    """Replaces this process by the program of the command."""
    require_nodes()
    words = {"command": command} | {name: getattr(args, name) for name in given}
    become("tools.main", [json.dumps(words)], environment_of(args))


def _place(text: str) -> tuple[float, float, float]:
    """Returns x, y in metres and the yaw in radians."""
    import math

    parts = text.split(",")
    try:
        x, y, yaw = (float(part) for part in (*parts, "0")[:3])
        if len(parts) not in (2, 3) or not all(map(math.isfinite, (x, y, yaw))):
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is not a position: must be X,Y or X,Y,YAW, such as 4.2,5.7 or 4.2,5.7,90"
        ) from None
    return x, y, math.radians(yaw)


def _count(text: str) -> int:
    if not text.isdigit() or not 0 < int(text) <= 1_000_000:
        raise argparse.ArgumentTypeError(f"{text!r} must be a whole number from 1 to 1000000")
    return int(text)


def _seconds(text: str) -> float:
    import math

    try:
        value = float(text)
        if not 0.0 <= value < math.inf:
            raise ValueError
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be a number of seconds, 0 or more") from None
    return value
