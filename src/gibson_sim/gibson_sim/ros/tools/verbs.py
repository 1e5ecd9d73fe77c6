"""The short verbs of ``gibson-sim``: spawn, move, delete, pause, play, step, reset, load, goal. Each calls one standard service."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from pathlib import Path

from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import DurabilityPolicy, QoSProfile
from simulation_interfaces.msg import SimulationState
from simulation_interfaces.srv import GetAvailableWorlds, LoadWorld

from gibson_sim.errors import GibsonSimError, SceneNotFoundError
from gibson_sim.quoting import quoted
from gibson_sim.resources import find_scene
from gibson_sim.ros.client.simulation_client import SimulationClient, flat_pose
from gibson_sim.ros.tools.hints import simulation_runs, spawned_as
from gibson_sim.ros.tools.tool import Tool
from gibson_sim.ros.topics import names
from gibson_sim.scenes.load import description_file
from gibson_sim.scenes.spawning import built_in_spawnables, spawn_name
from gibson_sim.settings import nearest
from gibson_sim.types import WORLD_FRAME

_LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
_SUBSCRIBER_S = 2.0
"""Timeout for the discovery of a subscriber of a goal, s of wall time."""


def spawn(tool: Tool, uri: str, at: tuple[float, float, float], name: str = "") -> str:
    """Spawns an entity on the floor at x, y (m) and yaw (rad); returns the text to print."""
    floor = _floor(tool)
    entity = tool.client.spawn(uri, at, floor.z, name)
    return f"spawned {entity if entity in (uri, name) else f'{uri} as {entity}'} at {at[0]:g},{at[1]:g}{floor.warning(at)}"


def move(tool: Tool, name: str, at: tuple[float, float, float]) -> str:
    """Moves an entity to x, y (m) and yaw (rad) on the floor, at rest; returns the text to print."""
    floor = _floor(tool)
    _with_hint(tool.client, name, lambda: tool.client.move(name, at, floor.z))
    return f"moved {name} to {at[0]:g},{at[1]:g}{floor.warning(at)}"


def delete(tool: Tool, name: str) -> str:
    """Removes an entity; returns the text to print."""
    _with_hint(tool.client, name, lambda: tool.client.delete(name))
    return f"deleted {name}"


def pause(tool: Tool) -> str:
    """Pauses the simulation; returns the text to print."""
    return "paused" if tool.client.pause() else "already paused"


def play(tool: Tool) -> str:
    """Lets time pass; returns the text to print."""
    return "playing" if tool.client.play() else "already playing"


def step(tool: Tool, steps: int) -> str:
    """Executes physics steps of a paused simulation; returns the text to print."""
    tool.client.step(steps)
    return f"executed {steps} step{'s' * (steps != 1)}"


def reset(tool: Tool) -> str:
    """Resets the simulation; returns the text to print."""
    tool.client.reset()
    return "reset: time, poses and spawned entities"


def load(tool: Tool, world: str) -> str:
    """Loads another scene; returns the text to print.

    Raises:
        GibsonSimError: the scene does not exist, or cannot be loaded. The service unloads the present world before it searches the scene,
            so a name is checked before.
    """
    _check_scene_name(tool, world)
    request = LoadWorld.Request()
    if hasattr(request, "world_resource"):  # 2.x
        request.world_resource.uri = world
    else:
        request.uri = world
    try:
        tool.client.ask("load_world", request)
    except GibsonSimError as error:
        runs = simulation_runs(tool.offered_services())
        if runs and tool.client.state == SimulationState.STATE_NO_WORLD:
            raise GibsonSimError(
                f"{error}; the previous world is unloaded, as the standard requires: load another one"
            ) from error
        raise
    return f"loaded {world}; it has no robot yet, and time is stopped: `gibson-sim spawn gibson_bot --at X,Y`, `gibson-sim play`"


def goal(tool: Tool, at: tuple[float, float, float]) -> str:
    """Publishes ``goal_pose`` for a navigation stack; returns the text to print."""
    publisher = tool.create_publisher(PoseStamped, "goal_pose", 1)
    if not tool.spin_until(_SUBSCRIBER_S, lambda: publisher.get_subscription_count() > 0):
        raise GibsonSimError("goal_pose has no subscriber: start a navigation stack, such as Nav2 or the one of gibson_examples")
    message = PoseStamped(pose=flat_pose(*at[:2], 0.0, at[2]))
    message.header.frame_id = WORLD_FRAME
    publisher.publish(message)
    publisher.wait_for_all_acked()
    return f"sent goal {at[0]:g},{at[1]:g}"


def _check_scene_name(tool: Tool, world: str) -> None:
    """Raises GibsonSimError if ``world`` is a bare name, and neither a scene that is found here nor one that the simulation lists."""
    if "/" in world or Path(world).suffix:  # a URI or a file, which only the simulation can resolve
        return
    try:
        description_file(find_scene(world))
    except SceneNotFoundError:
        listed = tool.client.call("get_available_worlds", GetAvailableWorlds.Request()).worlds
        known = sorted({name for entry in listed for name in (entry.name, entry.world_resource.uri) if "/" not in name})
        if world not in known:
            hint = nearest(world, known)
            text = f"scene {quoted(world)} does not exist; {f'{hint} ' if hint else ''}known: {', '.join(known) or 'none'}"
            raise GibsonSimError(f"{text}. The present world stays loaded") from None


def _with_hint(services: SimulationClient, name: str, act: Callable[[], None]) -> None:
    """Calls ``act`` for an entity; if ``name`` is a model of the catalogue, the error names the entities that were spawned from it."""
    try:
        act()
    except GibsonSimError as error:
        default_name = spawn_name(name, "") if name in built_in_spawnables() else ""
        if default_name and (hint := spawned_as(name, default_name, services.entities())):
            raise GibsonSimError(hint) from error
        raise


class _Floor:
    """The floor of an occupancy grid; None = there is no map."""

    def __init__(self, grid: OccupancyGrid | None) -> None:
        self._grid = grid
        self.z = 0.0 if grid is None else float(grid.info.origin.position.z)
        """Height of the floor, m."""

    def warning(self, at: tuple[float, float, float]) -> str:
        """Returns a warning if the map shows no floor at x, y (m); otherwise an empty text."""
        if self._grid is None:
            return ""
        info = self._grid.info
        column, row = (
            math.floor((value - start) / info.resolution)
            for value, start in ((at[0], info.origin.position.x), (at[1], info.origin.position.y))
        )
        is_known = 0 <= column < info.width and 0 <= row < info.height and self._grid.data[row * info.width + column] >= 0
        return "" if is_known else "; the map shows no floor at this position: the entity may fall"


def _floor(tool: Tool) -> _Floor:
    """Returns the floor of the published map; waits up to 2 s for it."""
    received: list[OccupancyGrid] = []
    tool.create_subscription(OccupancyGrid, names.MAP, received.append, _LATCHED)
    start = time.monotonic()
    tool.spin_until(2.0, lambda: bool(received) or (time.monotonic() - start > 1.0 and not tool.count_publishers(names.MAP)))
    return _Floor(received[0] if received else None)


VERBS: dict[str, Callable[..., str]] = {
    function.__name__: function for function in (spawn, move, delete, pause, play, step, reset, load, goal)
}
