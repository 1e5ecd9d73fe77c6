"""The short verbs of ``gibson-sim``: spawn, move, delete, pause, play, step, reset, load, goal. Each calls one standard service."""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import LoadWorld

from gibson_sim.errors import GibsonSimError
from gibson_sim.ros.client.requests import flat_pose
from gibson_sim.ros.client.standard_services import StandardServices
from gibson_sim.ros.tools.hints import simulation_runs, spawned_as
from gibson_sim.ros.tools.main import Tool
from gibson_sim.ros.topics import names
from gibson_sim.scenes.spawning import built_in_spawnables, spawn_name
from gibson_sim.types import WORLD_FRAME

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_SUBSCRIBER_S = 2.0
"""Wall time to wait for a subscriber of a goal, s."""


def spawn(tool: Tool, uri: str, at: tuple[float, float, float], name: str = "") -> str:
    """Puts a thing on the floor; returns what to print."""
    floor = _floor(tool)
    got = StandardServices(tool.call).spawn(uri, at, floor.z, name)
    return f"spawned {got if got in (uri, name) else f'{uri} as {got}'} at {at[0]:g},{at[1]:g}{floor.warning(at)}"


def move(tool: Tool, name: str, at: tuple[float, float, float]) -> str:
    """Puts an entity elsewhere on the floor, at rest; returns what to print."""
    services = StandardServices(tool.call)
    floor = _floor(tool)
    _of_entity(services, name, lambda: services.move(name, at, floor.z))
    return f"moved {name} to {at[0]:g},{at[1]:g}{floor.warning(at)}"


def delete(tool: Tool, name: str) -> str:
    """Removes an entity; returns what to print."""
    services = StandardServices(tool.call)
    _of_entity(services, name, lambda: services.delete(name))
    return f"deleted {name}"


def pause(tool: Tool) -> str:
    """Pauses the simulation; returns what to print."""
    return _set_state(tool, SimulationState.STATE_PAUSED, "paused")


def play(tool: Tool) -> str:
    """Lets time pass; returns what to print."""
    return _set_state(tool, SimulationState.STATE_PLAYING, "playing")


def step(tool: Tool, steps: int) -> str:
    """Makes physics steps of a paused simulation; returns what to print."""
    StandardServices(tool.call).ask("step_simulation", steps=steps)
    return f"made {steps} step{'s' * (steps != 1)}"


def reset(tool: Tool) -> str:
    """Resets the simulation; returns what to print."""
    StandardServices(tool.call).ask("reset_simulation")
    return "reset: time, poses and spawned entities"


def load(tool: Tool, world: str) -> str:
    """Loads another scene; returns what to print."""
    request = LoadWorld.Request()
    if hasattr(request, "world_resource"):  # 2.x
        request.world_resource.uri = world
    else:
        request.uri = world
    services = StandardServices(tool.call)
    try:
        services.send("load_world", request)
    except GibsonSimError as error:
        runs = simulation_runs(tool.offered_services())
        if runs and services.ask("get_simulation_state").state.state == SimulationState.STATE_NO_WORLD:
            raise GibsonSimError(f"{error}; the world before is unloaded, as the standard requires: load another one") from error
        raise
    return f"loaded {world}; it has no robot yet, and time is stopped: `gibson-sim spawn gibson_bot --at X,Y`, `gibson-sim play`"


def goal(tool: Tool, at: tuple[float, float, float]) -> str:
    """Publishes ``goal_pose`` for a navigation stack; returns what to print."""
    publisher = tool.create_publisher(PoseStamped, "goal_pose", 1)
    if not tool.work(_SUBSCRIBER_S, lambda: publisher.get_subscription_count() > 0):
        raise GibsonSimError("goal_pose has no subscriber: start a navigation stack, such as Nav2 or the one of gibson_examples")
    message = PoseStamped(pose=flat_pose(*at[:2], 0.0, at[2]))
    message.header.frame_id = WORLD_FRAME
    publisher.publish(message)
    publisher.wait_for_all_acked()
    return f"sent goal {at[0]:g},{at[1]:g}"


def _of_entity(services: StandardServices, name: str, act: Callable[[], None]) -> None:
    """Does something to an entity; the error for the name of a thing of the catalogue names the entities that it was spawned as."""
    try:
        act()
    except GibsonSimError as error:
        own_name = spawn_name(name, "") if name in built_in_spawnables() else ""
        if own_name and (hint := spawned_as(name, own_name, services.entities())):
            raise GibsonSimError(hint) from error
        raise


def _set_state(tool: Tool, state: int, text: str) -> str:
    return text if StandardServices(tool.call).set_state(state) else f"already {text}"


class _Floor:
    """The floor that a map shows; ``grid``: None = there is no map."""

    def __init__(self, grid: OccupancyGrid | None) -> None:
        self._grid = grid
        self.z = 0.0 if grid is None else float(grid.info.origin.position.z)
        """Its height, metres."""

    def warning(self, at: tuple[float, float, float]) -> str:
        """Returns what to add to an answer about a place, x and y in metres, where the map shows no floor; else nothing."""
        if self._grid is None:
            return ""
        info = self._grid.info
        column, row = (
            math.floor((value - start) / info.resolution)
            for value, start in ((at[0], info.origin.position.x), (at[1], info.origin.position.y))
        )
        known = 0 <= column < info.width and 0 <= row < info.height and self._grid.data[row * info.width + column] >= 0
        return "" if known else "; the map shows no floor there: what has nothing below it falls"


def _floor(tool: Tool) -> _Floor:
    """Returns the floor that the map shows."""
    got: list[OccupancyGrid] = []
    tool.create_subscription(OccupancyGrid, names.MAP, got.append, _LATCHED)
    begin = time.monotonic()
    tool.work(2.0, lambda: bool(got) or (time.monotonic() - begin > 1.0 and not tool.count_publishers(names.MAP)))
    return _Floor(got[0] if got else None)


VERBS: dict[str, Callable[..., str]] = {
    each.__name__: each for each in (spawn, move, delete, pause, play, step, reset, load, goal)
}
