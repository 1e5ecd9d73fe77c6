"""Starts the simulation: ros2 launch gibson_sim sim.launch.py scene:=linden_flat rate:=2.0

Every parameter of the physics node and the render node is an argument (--show-args lists them); params_file:=FILE.yaml sets many at once.
web:=true serves a page for any browser, foxglove:=true the Foxglove WebSocket protocol, rviz:=true starts RViz.
"""

import atexit
import os
import shutil
import tempfile

from ament_index_python.packages import PackageNotFoundError, get_package_prefix
from launch import LaunchDescription, logging
from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch_ros.actions import Node

from gibson_sim.cli.environment import enclave_variables
from gibson_sim.cli.job import MAX_RESTARTS, RESTART_WINDOW_S, USER_ERROR, Restarts
from gibson_sim.cli.launching import RVIZ, VIEWERS, arguments, misspelt, plan
from gibson_sim.errors import EnvironmentProblemError
from gibson_sim.reach import describe_reach, reach_variables


def generate_launch_description():
    known = arguments()
    return LaunchDescription(
        [
            # Runs before the arguments are declared: only those that the user set have a value, so that defaults do not override params_file.
            OpaqueFunction(function=_start),
            *[
                DeclareLaunchArgument(a.name, default_value=a.default, description=a.description, choices=list(a.choices) or None)
                for a in known
            ],
        ]
    )


def _start(context):
    """Starts the nodes with the arguments that the user set."""
    for warning in misspelt([text.partition(":=")[0] for text in context.argv]):
        logging.get_logger("gibson_sim").warning(warning)
    given = plan(context.launch_configurations)
    folder = tempfile.mkdtemp(prefix="gibson_sim_launch_")
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    reach = reach_variables(context.environment, given.reach)

    def node(start):
        file = os.path.join(folder, f"{start.node}.yaml")
        with open(file, "w") as out:
            out.write(given.overriding(start))
        return Node(
            package="gibson_sim",
            executable=f"{start.node}_node",
            namespace=given.namespace,
            parameters=[*([str(given.params_file)] if given.params_file else []), *([file] if start.parameters else [])],
            additional_env={**reach, **enclave_variables(context.environment, start.node)},  # for these nodes only
            output="screen",
        )

    starts = {start.node: start for start in given.nodes}
    running = {name: node(start) for name, start in starts.items()}
    if given.rviz is not None:
        running[RVIZ] = rviz(given, reach)
    restarts = Restarts(MAX_RESTARTS, RESTART_WINDOW_S)

    def on_exit(event, context):
        name = next((name for name, action in running.items() if action is event.action), None)
        if name is None or context.is_shutdown:
            return None
        if name == "physics" and event.returncode == 0:
            return EmitEvent(event=Shutdown(reason="the simulation is over"))
        if name == "render" and event.returncode == 0:
            return LogInfo(msg="the render node has ended; the simulation goes on without images")
        if name == RVIZ or (name in VIEWERS and event.returncode != USER_ERROR):
            return LogInfo(msg=f"the {name} node has ended; the simulation goes on without it")
        if name == "render" and event.returncode != USER_ERROR and restarts.allow():
            running[name] = node(starts[name])
            return [LogInfo(msg="the render node crashed; starting it again"), running[name]]
        # Without the physics node there is no time, and a renderer with a user's error fails again. An error makes launch end with code 1.
        raise RuntimeError(
            f"the {name} node ended with code {event.returncode}, so the simulation ends; see above for its reason"
        )

    return [
        LogInfo(msg=describe_reach({**context.environment, **reach}, "reach:=")),
        RegisterEventHandler(OnProcessExit(on_exit=on_exit)),
        *running.values(),
    ]


def rviz(given, reach):
    """Returns RViz, in the namespace of the simulation and with its time."""
    try:
        get_package_prefix("rviz2")
    except (PackageNotFoundError, OSError):  # OSError: there is no ament index at all
        raise EnvironmentProblemError(
            "rviz:=true needs RViz, which is not installed: `sudo apt install ros-jazzy-rviz2`"
        ) from None
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=given.namespace,
        arguments=list(given.rviz),
        parameters=[{"use_sim_time": True}],
        additional_env=reach,
        output="screen",
    )
