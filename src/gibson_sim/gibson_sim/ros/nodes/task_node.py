"""The task node: sets up episodes of a task in a running simulation, evaluates them, and runs a baseline policy if requested.

It uses only public interfaces: it spawns and deletes with simulation_interfaces, drives with cmd_vel, and subscribes to published topics.
With a baseline it is a lockstep participant: time waits while it computes.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from typing import Any

from geometry_msgs.msg import PoseStamped, Twist
from rclpy.node import Node
from sensor_msgs.msg import JointState
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from gibson_msgs.msg import Contacts, GraspState, Scene, SceneState as RosSceneState
from gibson_sim.client_config import TaskConfig
from gibson_sim.errors import GibsonSimError
from gibson_sim.ros import conversions
from gibson_sim.ros.client.simulation_client import SimulationClient, move_request, spawn_request
from gibson_sim.ros.lockstep.lockstep_client import LockstepParticipant
from gibson_sim.ros.nodes.node_main import is_running, make_executor, run_node
from gibson_sim.ros.nodes.params import config_from_parameters
from gibson_sim.ros.nodes.wait_for_simulation import WaitCondition
from gibson_sim.ros.topics import names, qos
from gibson_sim.tasks.controls import finger_joints
from gibson_sim.tasks.episode import Action, Episode, Observation, item_root, observation_of
from gibson_sim.tasks.ground import ground_of
from gibson_sim.tasks.metrics import Meter, Metrics, episode_line, episode_values, summary, summary_line, touched_by
from gibson_sim.tasks.registry import check_baseline, task_of
from gibson_sim.tasks.run import CONTROL_HZ, SETTLE_S
from gibson_sim.tasks.task import Policy
from gibson_sim.types import NS_PER_S, WORLD_FRAME, Contact, Pose, SceneState, Vec3
from gibson_sim.writing import write_file

GOAL, INFO, RESULT, RESET = "task/goal", "task/info", "task/result", "task/reset"
_PERIOD_NS = NS_PER_S // CONTROL_HZ
"""Period of a baseline's commands, ns of simulation time."""


class TaskNode(Node):
    """Runs episodes one after the other. With a baseline it ends after the last one; otherwise each reset begins the next one.

    Parameters: the fields of ``gibson_sim.client_config.TaskConfig``.

    Subscribes:
        scene, scene_state: poses. contacts: bodies that the robot touches. joint_states, grasp_state: if the robot has an arm.

    Publishes:
        task/goal (geometry_msgs/PoseStamped, latched): the goal position, or the object of the task; not in search tasks.
        task/info (std_msgs/String, latched): the episode as JSON: task, seed, text, target_class, start, time_limit, shortest.
        task/result (std_msgs/String, latched): the result of an episode as JSON: seed, success, time, path_length, spl, ...
        cmd_vel, joint_command, grasp: only with a baseline.

    Services:
        task/reset (std_srvs/Trigger): ends the episode and begins the next one; the message is its task/info.

    Calls:
        spawn_entity, delete_entity, set_entity_state, reset_simulation.
    """

    def __init__(self, **kwargs: Any) -> None:
        """Checks the settings and loads the scene for planning. ``kwargs`` go to ``rclpy.node.Node``.

        Raises:
            GibsonSimError: a setting, the scene or the robot cannot be used.
        """
        super().__init__("task", **kwargs)
        self._config = config = config_from_parameters(self, TaskConfig)
        self._task = task_of(config.task)
        check_baseline(self._task, config.baseline)
        self._ground = ground_of(config.scene or self._task.scene, config.robot or self._task.robot)
        self._links: dict[int, tuple[str, ...]] = {}
        self._scene_name = ""
        self._state: SceneState | None = None
        self._early: RosSceneState | None = None
        """A state that arrived before its scene."""
        self._joints: dict[str, float] = {}
        self._joints_ns = self._grasp_ns = -1
        self._control_ns: int | None = None
        """Stamp of the tick that the baseline answers with commands; earlier ticks are reported as done immediately. None = all are."""
        self._pending_stamp: Any = None
        """Stamp of the tick that waits for commands."""
        self._held, self._touched = "", frozenset[str]()
        self._reset_requested = False
        self._next_seed = config.seed
        self._spawned: list[str] = []
        self._results: list[Metrics] = []
        self._subscribe()
        self._goal_pub = self.create_publisher(PoseStamped, GOAL, qos.LATCHED)
        self._info_pub = self.create_publisher(String, INFO, qos.LATCHED)
        self._result_pub = self.create_publisher(String, RESULT, qos.LATCHED)
        self._velocity_pub = self.create_publisher(Twist, names.CMD_VEL, qos.COMMAND)
        self._joint_pub = self.create_publisher(JointState, names.JOINT_COMMAND, qos.COMMAND)
        self._grasp_pub = self.create_publisher(Bool, names.GRASP, qos.COMMAND)
        self._simulation = SimulationClient(
            self, lambda condition, awaited: self._wait(condition, str(awaited)), names_service=True
        )
        for service in ("spawn_entity", "delete_entity", "set_entity_state", "reset_simulation"):
            self._simulation.prepare(service)
        self.create_service(Trigger, RESET, self._on_reset)
        self._executor = make_executor()
        self._executor.add_node(self)
        has_baseline = config.baseline != "none"
        self._lockstep = LockstepParticipant(self) if has_baseline else None

    def _subscribe(self) -> None:
        self.create_subscription(Scene, names.SCENE, self._on_scene, qos.LATCHED)
        self.create_subscription(RosSceneState, names.SCENE_STATE, self._on_state, qos.STATE)
        self.create_subscription(Contacts, names.CONTACTS, self._on_contacts, qos.STATE)
        if self._ground.robot.manipulators:
            self.create_subscription(JointState, names.JOINT_STATES, self._on_joints, qos.STATE)
            self.create_subscription(GraspState, names.GRASP_STATE, self._on_grasp, qos.STATE)

    def _on_scene(self, msg: Scene) -> None:
        scene = conversions.scene_from_msg(msg)
        self._scene_name, self._links[scene.revision] = scene.name, scene.links
        if self._early is not None and self._early.revision == scene.revision:
            self._state, self._early = conversions.scene_state_from_msg(self._early, scene.links), None

    def _on_state(self, msg: RosSceneState) -> None:
        links = self._links.get(msg.revision)
        if links is None:
            self._early = msg
        else:
            self._state, self._early = conversions.scene_state_from_msg(msg, links), None
        if self._lockstep is None:
            return
        if self._control_ns is None or conversions.time_from_msg(msg.header.stamp) < self._control_ns:
            self._lockstep.tick_done(msg.header.stamp)
        else:
            self._pending_stamp = msg.header.stamp

    def _finish_tick(self, sent: Sequence[str], control_ns: int | None) -> None:
        """Reports the waiting tick as done in lockstep, with the topics ``sent`` of commands, and sets the stamp of the next tick to answer."""
        self._control_ns = control_ns
        if self._lockstep is not None and self._pending_stamp is not None:
            self._lockstep.tick_done(self._pending_stamp, sent)
        self._pending_stamp = None

    def _on_contacts(self, msg: Contacts) -> None:
        moving = {link.partition("/")[0] for link in (self._state.links if self._state else ())}
        contacts = [
            Contact(c.body_a, c.link_a, c.body_b, c.link_b, _xyz(c.position), _xyz(c.normal), c.force, c.distance)
            for c in msg.contacts
        ]
        self._touched = touched_by(self._ground.robot.name, contacts, moving)

    def _on_joints(self, msg: JointState) -> None:
        self._joints.update(zip(msg.name, msg.position, strict=True))
        self._joints_ns = conversions.time_from_msg(msg.header.stamp)

    def _on_grasp(self, msg: GraspState) -> None:
        self._held = msg.body if msg.holding else ""
        self._grasp_ns = conversions.time_from_msg(msg.header.stamp)

    def _on_reset(self, _: Any, response: Any) -> Any:
        self._reset_requested = True
        response.success, response.message = True, f"the episode of seed {self._next_seed} begins"
        return response

    def spin(self) -> int:
        """Runs the episodes; returns the exit code.

        Raises:
            GibsonSimError: no simulation runs, or it has another scene or robot than the task.
        """
        self._wait_for(WaitCondition.for_simulation(self, names.SCENE_STATE, self._config.timeout))
        self._wait(lambda: self._state is not None, "a message on scene_state")
        expected = self._ground.scene.name
        if self._scene_name != expected:
            raise GibsonSimError(
                f"the simulation runs scene {self._scene_name!r}, the task needs {expected!r}; start it with --scene, or give it as --scene"
            )
        robot = f"{self._ground.robot.name}/{self._ground.robot.base_link}"
        assert self._state is not None
        if robot not in self._state.links:
            raise GibsonSimError(
                f"the simulation has no robot with a link {robot!r}; start it with --robot {self._config.robot or self._task.robot}"
            )
        waits_for_reset = self._config.baseline == "none"
        number = 0
        while is_running() and (waits_for_reset or number < self._config.episodes):
            seed = self._config.seed + number
            self._results.append(self._episode(seed))
            print(episode_line(seed, self._results[-1]), flush=True)
            number += 1
            while waits_for_reset and is_running() and not self._reset_requested:
                self._executor.spin_once(timeout_sec=0.1)
        if is_running():
            self._report()
        return 0

    def _episode(self, seed: int) -> Metrics:
        """Sets up an episode, runs it with the baseline or another node, and returns its metrics."""
        self._next_seed = seed + 1
        episode = self._task.generate(seed, self._ground)
        begin_ns = self._set_up(episode)
        observation = self._observe(begin_ns)
        meter = Meter(episode, observation)
        policy = None if self._config.baseline == "none" else self._task.policy(self._config.baseline, episode, self._ground)
        self._announce(episode)
        success = False
        while is_running() and not (success or self._reset_requested or observation.time >= episode.time_limit):
            control_ns = begin_ns + round(observation.time * NS_PER_S) + _PERIOD_NS
            self._finish_tick(self._act(policy, observation) if policy is not None else (), control_ns)
            observation = self._observe(begin_ns, control_ns)
            meter.update(observation, self._touched)
            success = self._task.succeeded(episode, observation, self._ground)
        if policy is not None:
            self._velocity_pub.publish(Twist())
            self._finish_tick((self._velocity_pub.topic_name,), None)
        metrics = meter.metrics(
            observation, success=success, goal_distance=self._task.remaining(episode, observation, self._ground)
        )
        self._result_pub.publish(String(data=json.dumps({"seed": seed, **episode_values(metrics)})))
        return metrics

    def _act(self, policy: Policy, observation: Observation) -> list[str]:
        """Publishes the commands of a baseline; returns the topic of each message."""
        action: Action = policy.act(observation)
        twist = Twist()
        twist.linear.x, twist.angular.z = float(action.linear), float(action.angular)
        self._velocity_pub.publish(twist)
        sent = [self._velocity_pub.topic_name]
        joints = {**action.joints, **finger_joints(self._ground.robot, action.grasp)}
        if joints:
            self._joint_pub.publish(JointState(name=list(joints), position=[float(p) for p in joints.values()]))
            sent.append(self._joint_pub.topic_name)
        if action.grasp is not None and action.grasp != bool(self._held):
            self._grasp_pub.publish(Bool(data=action.grasp))
            sent.append(self._grasp_pub.topic_name)
        return sent

    def _set_up(self, episode: Episode) -> int:
        """Sets up the scene of an episode; returns the stamp at which the episode begins, ns."""
        self._reset_requested = False
        self._velocity_pub.publish(Twist())
        self._clean_up(episode)
        pose = conversions.pose_to_msg(episode.start)
        self._simulation.ask("set_entity_state", move_request(self._ground.robot.name, pose))
        for name in episode.removed:
            self._simulation.ask("delete_entity", entity=name)
        for item in episode.items:
            text, pose = item.text, conversions.pose_to_msg(item.pose)
            self._simulation.ask("spawn_entity", spawn_request(pose, item.name, "" if text else item.model, text))
            self._spawned.append(item.name)
        roots = {item_root(item) for item in episode.items}
        assert self._state is not None
        self._control_ns = begin_ns = self._state.stamp_ns + round(SETTLE_S * NS_PER_S)
        self._wait(lambda: self._is_set_up(roots, begin_ns), "state of the scene with all items in it")
        return self._state.stamp_ns

    def _is_set_up(self, roots: set[str], begin_ns: int) -> bool:
        return self._has_data_since(begin_ns) and self._state is not None and roots <= set(self._state.links)

    def _clean_up(self, episode: Episode) -> None:
        """Deletes the items of the previous episode. If an arm may have moved, or a body is missing or in conflict, resets the simulation."""
        present = self._bodies()
        new = {item.name for item in episode.items}
        arm_moved = bool(self._results) and bool(self._ground.robot.manipulators)
        if arm_moved or not present >= set(episode.removed) or (present & new) - {*episode.removed, *self._spawned}:
            removed, restored = set(self._spawned), {body.name for body in self._ground.scene.bodies}
            self._simulation.reset()
            self._joints_ns = self._grasp_ns = -1
            self._wait(
                lambda: not removed & self._bodies() - restored and restored <= self._bodies(), "state of the scene after a reset"
            )
        else:
            for name in self._spawned:
                self._simulation.ask("delete_entity", entity=name)
        self._spawned.clear()

    def _bodies(self) -> set[str]:
        """Returns the names of all robots and bodies in the state."""
        return {link.partition("/")[0] for link in (self._state.links if self._state else ())}

    def _announce(self, episode: Episode) -> None:
        """Publishes the info and the goal of an episode."""
        goal = episode.goal
        values = {
            "task": episode.task, "seed": episode.seed, "text": goal.text, "target_class": goal.target_class,
            "start": [*episode.start.position, *episode.start.quat_xyzw], "time_limit": episode.time_limit,
            "shortest": None if math.isnan(episode.shortest) else episode.shortest,
        }  # fmt: skip
        self._info_pub.publish(String(data=json.dumps(values)))
        if goal.position is not None and self._state is not None:
            message = PoseStamped(header=conversions.header_to_msg(self._state.stamp_ns, WORLD_FRAME))
            message.pose = conversions.pose_to_msg(Pose(goal.position))
            self._goal_pub.publish(message)

    def _observe(self, begin_ns: int, from_ns: int = -1) -> Observation:
        """Returns the observation at the first tick not before ``from_ns``."""
        self._wait(lambda: self._has_data_since(from_ns), "scene_state: is the simulation paused?")
        assert self._state is not None
        robot = self._ground.robot
        return observation_of(self._state, robot.name, robot.base_link, begin_ns, joints=dict(self._joints), held=self._held)

    def _has_data_since(self, from_ns: int) -> bool:
        """Returns whether all data of a tick not before ``from_ns`` have arrived."""
        stamps = [self._state.stamp_ns if self._state is not None else -1]
        stamps += [self._joints_ns, self._grasp_ns] if self._ground.robot.manipulators else []
        return min(stamps) >= from_ns

    def _wait(self, condition: Callable[[], bool], awaited: str) -> None:
        self._wait_for(WaitCondition(self, awaited, condition, timeout_s=self._config.timeout))

    def _wait_for(self, condition: WaitCondition) -> None:
        while not condition.is_met():
            if not is_running():
                raise KeyboardInterrupt
            self._executor.spin_once(timeout_sec=0.1)

    def _report(self) -> None:
        total = summary(self._results)
        print(summary_line(self._task.name, self._config.baseline, total), flush=True)
        if self._config.output:
            episodes = [{"seed": self._config.seed + k, **episode_values(m)} for k, m in enumerate(self._results)]
            values = {"task": self._task.name, "baseline": self._config.baseline, **episode_values(total), "all": episodes}
            write_file(self._config.output, json.dumps(values, indent=1) + "\n")

    def close(self) -> None:
        """Leaves lockstep and shuts the executor down; spawned items stay in the simulation."""
        if self._lockstep is not None:
            self._lockstep.leave()
        self._executor.shutdown(timeout_sec=5.0)


def _xyz(msg: Any) -> Vec3:
    return msg.x, msg.y, msg.z


def main(args: list[str] | None = None) -> None:
    """Runs the task node."""
    run_node(TaskNode, args)


if __name__ == "__main__":
    main()
