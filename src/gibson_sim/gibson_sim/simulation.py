"""A simulation in one process, without ROS: scene, robots, physics, sensors and renderer behind one class."""

from __future__ import annotations

import logging
import math
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Any, Protocol, TypeVar, cast

import numpy as np

from gibson_sim.config import PhysicsConfig, parse_fill
from gibson_sim.errors import CommandError, ConfigError, GibsonSimError, PhysicsError
from gibson_sim.geometry.transforms import quat_from_rpy, yaw_from_quat
from gibson_sim.maps.floor_extent import extent_of_scene
from gibson_sim.maps.placement import in_namespace, place_robot, place_robots
from gibson_sim.physics.start_checks import warn_of_misplaced_robots
from gibson_sim.physics.world import PhysicsWorld
from gibson_sim.quoting import quoted
from gibson_sim.robots.joints.commands import JointPositions
from gibson_sim.robots.spec import RobotSpec
from gibson_sim.scenes.load import load_scene
from gibson_sim.scenes.load_views import read_views
from gibson_sim.scenes.spawning import load_spawnable
from gibson_sim.scenes.spec import DrawnScene, LightSpec, SceneSpec, drawn_scene
from gibson_sim.scenes.views import Views
from gibson_sim.sensors.battery import BatteryReading
from gibson_sim.sensors.bumper import BumperReading
from gibson_sim.sensors.depth_noise import apply_depth_noise
from gibson_sim.sensors.imu import ImuReading
from gibson_sim.sensors.lidar import Scan, measure_scan, noise_of
from gibson_sim.sensors.suite import Measurements, SensorSuite
from gibson_sim.settings import nearest
from gibson_sim.types import (
    WORLD_FRAME,
    CameraSpec,
    Contact,
    Frame,
    JointStates,
    Odometry,
    Output,
    Pose,
    SceneState,
    Vec3,
    VelocityCommand,
    check_seed,
)

if TYPE_CHECKING:
    from gibson_sim.render.readback.tensors import TensorFrame
    from gibson_sim.render.renderer import Renderer

Reading = ImuReading | BumperReading | BatteryReading

logger = logging.getLogger(__name__)


class _Named(Protocol):
    @property
    def name(self) -> str: ...


T = TypeVar("T", bound=_Named)
V = TypeVar("V")
_DEFAULTS = PhysicsConfig()
_NEVER_S = 1e9
"""Command timeout if none is given, seconds of simulation time: longer than any run."""


@dataclass(frozen=True)
class SavedRun:
    """A saved state of a simulation: all inputs since its beginning. ``Simulation.restore`` restores it."""

    step: int
    """Number of physics steps since the beginning."""
    inputs: tuple[tuple[int, str, tuple[Any, ...]], ...]
    """(step, method, arguments) of each call that changed the simulation."""
    of: tuple[Any, ...] = ()
    """Identity of the simulation: scene, robots and settings."""


class Body:
    """A robot or another body of a simulation. Its properties are current values, in SI units, in the world frame unless noted."""

    def __init__(self, world: PhysicsWorld, name: str) -> None:
        self._world, self.name = world, name

    @property
    def pose(self) -> Pose:
        """T_world_root: position, metres, and quaternion (x, y, z, w)."""
        return self._world.body_pose(self.name)

    @property
    def yaw(self) -> float:
        """Heading about the world's z axis, radians, counter-clockwise from x."""
        return yaw_from_quat(self.pose.quat_xyzw)

    @property
    def joints(self) -> JointStates:
        """Positions and velocities of its moving joints, radians or metres, and per second; a door has one joint, a box none."""
        return self._world.joint_states(self.name)

    @property
    def contacts(self) -> tuple[Contact, ...]:
        """Its contacts in the last step, including those with the floor."""
        return self._world.contacts(self.name)

    def __repr__(self) -> str:
        kind = type(self).__name__
        try:
            x, y, _ = self.pose.position
            return f"<{kind} {self.name}: x {x:.3f} m, y {y:.3f} m, yaw {math.degrees(self.yaw):.1f} deg>"
        except GibsonSimError:
            return f"<{kind} {self.name}: removed>"


class Robot(Body):
    """A robot of a simulation. Its properties are current values, in SI units, in the world frame unless noted."""

    @property
    def spec(self) -> RobotSpec:
        """Description: drive, sensors, cameras, size."""
        return next(robot for robot in self._world.scene.robots if robot.name == self.name)

    @property
    def pose(self) -> Pose:
        """T_world_base: position, metres, and quaternion (x, y, z, w)."""
        return self._world.base_pose(self.name)

    @property
    def twist(self) -> tuple[Vec3, Vec3]:
        """Linear (m/s) and angular (rad/s) velocity of the base, in the BASE frame."""
        return self._world.base_twist(self.name)

    @property
    def odometry(self) -> Odometry:
        """Wheel odometry in the odom frame; differs from ``pose`` where wheels slip or have errors."""
        return self._world.odometry(self.name)


class Simulation:
    """Scene, robots, physics, sensors and renderer in one process. Close it, or use it in a ``with`` statement.

    Simulation time passes only in ``step``; all other calls are instantaneous. Equal arguments and equal calls give bit-equal states, sensor
    readings and images. Not thread-safe; the renderer belongs to the thread that draws first.

    Example:
        >>> import gibson_sim as gs
        >>> with gs.Simulation("flat", robot="gibson_bot", seed=0) as sim:
        ...     sim.command(linear=0.3, angular=0.1)
        ...     state = sim.step(seconds=1.0)
        ...     frame = sim.render("camera", outputs=["rgb", "depth"])
        >>> state.step, frame.rgb.shape, frame.stamp_ns == state.stamp_ns
        (240, (480, 640, 3), True)
    """

    def __init__(
        self,
        scene: str | Path | SceneSpec = _DEFAULTS.world.scene,
        robot: str | Path | RobotSpec | None = _DEFAULTS.world.robot,
        *,
        start: str | Sequence[float] = "",
        seed: int = 0,
        step_hz: int = _DEFAULTS.time.step_hz,
        publish_hz: int | None = None,
        cmd_vel_timeout: float | None = None,
        views: str = "",
        view_size: tuple[int, int] = (640, 480),
        device: int | str | None = None,
    ) -> None:
        """Loads scene and robots. OpenGL is loaded by the first ``render``.

        Args:
            scene: name, folder, world or mesh file, as for ``gibson-sim run --scene``; or a loaded scene, whose robots are kept.
            robot: name, file or spec; several as ``left=gibson_bot,right=gibson_bot``; None = only the robots of the scene.
            start: name of a start pose (``scene.starts``), or ``x,y,yaw_deg`` as text or numbers; for several robots as text, separated by
                ``;``. Empty = the first start pose of the scene.
            seed: seed of the errors of all sensors and of odometry, 0 or more.
            step_hz: physics steps per second of simulation time.
            publish_hz: rate of the ticks at which bumpers measure, Hz; must divide ``step_hz``. None = 60, or ``step_hz`` if 60 does not
                divide it.
            cmd_vel_timeout: seconds of simulation time after which a velocity command expires, as on a real robot; None = it is valid until
                the next one.
            views: additional chase cameras, such as ``follow,top,orbit``, or a file of cameras; ``render`` accepts ``follow`` or
                ``view_follow`` as a name.
            view_size: width and height of the views, pixels.
            device: EGL device that renders, number or UUID as listed by ``gibson-sim doctor``; None = a GPU if one works, else software.

        Raises:
            GibsonSimError: scene, robot or a setting cannot be used; the message names the value, what is allowed and the remedy.
        """
        if isinstance(seed, bool) or not isinstance(seed, (int, np.integer)):
            raise ConfigError(f"seed is {quoted(seed)}, must be a whole number, 0 or more")
        check_seed("simulation", int(seed))
        for what, value in (("step_hz", step_hz), ("publish_hz", publish_hz), ("cmd_vel_timeout", cmd_vel_timeout)):
            if value is not None:
                _number(what, value)
        if not isinstance(views, str):
            raise ConfigError(f"views is {quoted(views)}, must be text such as 'follow,top'")
        start = (
            start if isinstance(start, str) else ",".join(map(str, _numbers("start", start, "x, y in metres and yaw in degrees")))
        )
        loaded = scene if isinstance(scene, SceneSpec) else load_scene(scene)
        if isinstance(robot, RobotSpec):
            loaded = place_robot(loaded, robot, start)
        elif robot is not None and str(robot):
            loaded = place_robots(loaded, str(robot), start)
        self._initial, self._seed, self._device = loaded, seed, device
        if publish_hz is not None and publish_hz < 1:
            raise ConfigError(f"publish_hz is {publish_hz}, must be 1 Hz or more and divide step_hz")
        usual = _DEFAULTS.time.publish_hz if step_hz % _DEFAULTS.time.publish_hz == 0 else step_hz
        self._tick_hz = usual if publish_hz is None else publish_hz
        self._view_specs = read_views(views, _view_size(view_size))
        self._renderer: Renderer | None = None
        self._loaded: DrawnScene | None = None
        """Scene that the renderer has loaded."""
        self._drawn: tuple[int, LightSpec, DrawnScene, Views] | None = None
        self._light = loaded.light
        self._suites: dict[str, SensorSuite] = {}
        self._measures_in_step: dict[str, Callable[[str], bool]] = {}
        """Robot -> predicate: whether ``step`` measures the sensor of a name."""
        self._readings: dict[tuple[str, str], Reading] = {}
        self._inputs: list[tuple[int, str, tuple[Any, ...]]] = []
        self._closed = False
        timeout = _NEVER_S if cmd_vel_timeout is None else cmd_vel_timeout
        self._command_timeout = timeout
        self.world = PhysicsWorld(loaded, step_hz=step_hz, cmd_vel_timeout=timeout, seed=seed)
        """The physics world, for functions that this class does not have: grasping, rays, joint efforts, attachments."""
        try:
            self._add_suites()
            warn_of_misplaced_robots(self.world)
        except BaseException:
            self.close()
            raise

    # Content

    @property
    def scene(self) -> SceneSpec:
        """The current scene, including spawned and excluding removed robots and bodies."""
        return self.world.scene

    @property
    def robots(self) -> Mapping[str, Robot]:
        """Robots by name, in their order; an unknown name raises CommandError."""
        return _ByName("robot", {robot.name: Robot(self.world, robot.name) for robot in self.world.scene.robots})

    @property
    def bodies(self) -> Mapping[str, Body]:
        """Bodies other than robots, such as doors and chairs, by name; ``command_joints`` moves their joints.

        An unknown name raises CommandError.
        """
        return _ByName("body", {body.name: Body(self.world, body.name) for body in self.world.scene.bodies})

    @property
    def semantic_classes(self) -> tuple[str, ...]:
        """Class names by their index in ``Frame.semantic``; indices may change when a body of a new class is spawned."""
        return self._drawn_now()[0].semantic_classes

    @property
    def instances(self) -> tuple[str, ...]:
        """Names of static visuals and bodies by their index in ``Frame.instance``; 0 = nothing."""
        return self._drawn_now()[0].instances

    @property
    def robot(self) -> Robot:
        """The first robot.

        Raises:
            CommandError: there is no robot.
        """
        return Robot(self.world, self._robot_name(None))

    @property
    def time(self) -> float:
        """Simulation time since the beginning, seconds; ``state.stamp_ns`` is the same in whole nanoseconds."""
        return self.world.step_count / self.world.step_hz

    @property
    def state(self) -> SceneState:
        """Current poses and velocities of all links; its arrays are read-only copies."""
        return self.world.state()

    @property
    def cameras(self) -> tuple[CameraSpec, ...]:
        """The cameras of all robots, then the views; ``render`` accepts their names."""
        return self._drawn_now()[0].cameras

    # Time

    def step(self, *, seconds: float | None = None, steps: int | None = None) -> SceneState:
        """Executes physics steps, and returns the state after them. Sensors measure at each step at which they are due.

        Args:
            seconds: simulation time; must be a whole number of physics steps (``1 / step_hz``), within a millionth of a step.
            steps: number of physics steps; give this or ``seconds``. Neither = one step.

        Raises:
            ConfigError: both are given, or the number of steps is not a whole number, 0 or more; the message names the nearest valid values.
        """
        count = self._steps(seconds, steps)
        try:
            return self._made(count)
        except SystemError as error:  # Ctrl-C inside of a compiled loop
            if isinstance(error.__cause__ or error.__context__, KeyboardInterrupt):
                raise KeyboardInterrupt from error
            raise

    def _made(self, count: int) -> SceneState:
        world = self.world
        for _ in range(count):
            world.step(1)
            for name, suite in self._suites.items():
                measured = suite.measure(world, world.step_count, world.stamp_ns, self._measures_in_step[name])
                if measured:
                    self._note(name, measured)
        return world.state()

    def _steps(self, seconds: float | None, steps: int | None) -> int:
        if seconds is not None and steps is not None:
            raise ConfigError(f"step takes seconds ({seconds:g}) or steps ({steps}), not both")
        for what, value in (("seconds", seconds), ("steps", steps)):
            if value is not None:
                _number(what, value)
        count = float(1 if steps is None else steps) if seconds is None else seconds * self.world.step_hz
        if not (math.isfinite(count) and count >= 0 and abs(count - round(count)) < 1e-6):
            requested = f"{steps} steps" if seconds is None else f"{seconds:g} s, {count:g} steps of 1/{self.world.step_hz} s"
            hint = self._nearest_steps(count) if math.isfinite(count) else ""
            raise ConfigError(f"step by {requested}: must be a finite whole number of steps, 0 or more{hint}")
        return round(count)

    def _nearest_steps(self, count: float) -> str:
        """Returns the nearest valid numbers of steps, with their seconds, for an error message."""
        allowed = sorted({max(0, math.floor(count)), max(0, math.ceil(count))})
        return "; nearest: " + " or ".join(f"steps={steps} ({steps / self.world.step_hz:g} s)" for steps in allowed)

    def reset(self) -> SceneState:
        """Restarts at time 0 with the initial robots and bodies; the following states are bit-equal to those of a new simulation."""
        world = self.world
        world.repopulate(self._initial.robots, self._initial.bodies)
        world.set_step_count(0)
        self._light = self._initial.light
        self._inputs.clear()
        self._suites.clear()
        self._readings.clear()
        self._add_suites()
        return world.state()

    def save(self) -> SavedRun:
        """Returns the current state for ``restore``: all inputs since the beginning, a few numbers for each call."""
        self._check_open()
        return SavedRun(self.world.step_count, tuple(self._inputs), self._identity())

    def restore(self, saved: SavedRun) -> SceneState:
        """Restores a saved state exactly, including contacts, the internal state of joints and motors, and sensor errors.

        It resets and replays all inputs, which takes as long as the original steps. Direct calls of ``world`` are not replayed.

        Args:
            saved: result of ``save`` of this simulation, or of one with equal arguments.

        Raises:
            ConfigError: it is from a simulation with another scene, robot or setting; the simulation is unchanged.
        """
        if not isinstance(saved, SavedRun):
            raise ConfigError(f"restore takes the result of save, not {quoted(saved)}")
        if saved.of != self._identity():
            raise ConfigError(
                "the saved run belongs to another simulation: scene, robots, step_hz, cmd_vel_timeout and seed must be equal"
            )
        self.reset()
        for step, method, arguments in saved.inputs:
            self.step(steps=step - self.world.step_count)
            getattr(self, method)(*arguments)
        return self.step(steps=saved.step - self.world.step_count)

    # Commands

    def command(self, linear: float = 0.0, angular: float = 0.0, lateral: float = 0.0, robot: str | None = None) -> None:
        """Commands the velocity of a robot from the next step on, until the next command or ``cmd_vel_timeout``; the drive limits it.

        Args:
            linear: forward velocity, m/s.
            angular: yaw rate, rad/s, counter-clockwise.
            lateral: velocity to the left, m/s; must be 0 except for omnidirectional drives.
            robot: name of the robot; None = the first robot.

        Raises:
            CommandError: a number is not finite, the robot does not exist, or its drive cannot execute the command.
        """
        self._check_open()
        name = self._robot_name(robot)
        linear, angular, lateral = _number("linear", linear), _number("angular", angular), _number("lateral", lateral)
        velocity = VelocityCommand((linear, lateral, 0.0), (0.0, 0.0, angular), self.world.stamp_ns)
        drive = self.robots[name].spec.drive
        # Over ROS, `linear.y` of a Twist is ignored instead, since teleoperation nodes send the same message to all kinds of robots.
        if lateral and drive is not None and drive.kind not in ("omni", "planar"):
            raise CommandError(
                f"robot {quoted(name)} has a drive of type {drive.kind}, which cannot move sideways: lateral is {lateral:g} m/s, must be 0"
            )
        self.world.command(name, velocity)
        self._inputs.append((self.world.step_count, "command", (linear, angular, lateral, name)))

    def command_joints(self, positions: Mapping[str, float], name: str | None = None) -> None:
        """Commands joints of a robot, or of a body such as a door, to positions, as fast as their limits allow.

        Args:
            positions: joint name -> radians or metres.
            name: robot or body; None = the first robot.

        Raises:
            CommandError: the robot, body or joint does not exist, or the goal is beyond the joint's limits.
        """
        self._check_open()
        name = name if name is not None else self._robot_name(None)
        if not isinstance(positions, Mapping):
            raise ConfigError(f"positions is {quoted(positions)}, must map names of joints to radians or metres")
        positions = {str(joint): _number(f"position of {quoted(joint)}", value) for joint, value in positions.items()}
        self.world.command_joints(name, JointPositions(tuple(positions.values()), tuple(positions)))
        self._inputs.append((self.world.step_count, "command_joints", (dict(positions), name)))

    def spawn(self, uri: str | Path, name: str, position: Vec3 = (0.0, 0.0, 0.0), yaw: float = 0.0) -> None:
        """Adds a body or a robot to the scene.

        Args:
            uri: name of a built-in object (``gibson_sim.list_objects``) or robot, or a URDF, SDF, robot.yaml or mesh file.
            name: name of the new body: letters, digits and _, a letter first. Cameras of a robot are named ``<name>/<camera>``.
            position: position of its root link, metres, world frame.
            yaw: rotation about the world's z axis, radians.

        Raises:
            SceneError: the resource cannot be loaded; the message names the file and the error.
            PhysicsError: the name is in use, or a robot would overlap another body.
        """
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z]\w*", name, re.ASCII) or name == WORLD_FRAME:
            raise ConfigError(f"name is {quoted(name)}, must be letters, digits and _, a letter first, and not {WORLD_FRAME!r}")
        spec = load_spawnable(str(uri), "", name=name, pose=_upright(position, yaw))
        self.world.add(in_namespace(spec, name) if isinstance(spec, RobotSpec) else spec)
        self._add_suites()
        self._inputs.append((self.world.step_count, "spawn", (uri, name, tuple(position), yaw)))

    def move(self, name: str, position: Vec3, yaw: float = 0.0) -> None:
        """Sets the pose of a robot or a body, upright and at rest.

        The pose is not checked for collisions: an overlapping body is pushed out by the next steps.

        Args:
            name: robot or body.
            position: position of its root link, metres, world frame.
            yaw: rotation about the world's z axis, radians.

        Raises:
            PhysicsError: no robot or body has this name.
        """
        self.world.set_state(name, _upright(position, yaw), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
        self._inputs.append((self.world.step_count, "move", (name, tuple(position), yaw)))

    def remove(self, name: str) -> None:
        """Removes a robot or a body from the scene.

        Raises:
            PhysicsError: no robot or body has this name.
        """
        self.world.remove(name)
        self._suites.pop(name, None)
        self._readings = {of: reading for of, reading in self._readings.items() if of[0] != name}
        self._inputs.append((self.world.step_count, "remove", (name,)))

    # Sensors

    def scan(self, lidar: str = "", robot: str | None = None) -> Scan:
        """Returns a scan of a planar lidar at the current time, with its errors; ROS nodes publish the same scan at the lidar's rate.

        Args:
            lidar: name of the lidar; empty = the first lidar of the robot.
            robot: name of the robot; None = the first robot.

        Raises:
            ConfigError: the robot does not have the lidar.
        """
        self._check_open()
        name = self._robot_name(robot)
        spec = self._one_of(self.robots[name].spec.sensors.lidars, lidar, "lidar")
        return measure_scan(spec, self.world.state_of(name), self.world.cast_rays, noise_of(name, spec, self._seed))

    def reading(self, sensor: str, robot: str | None = None) -> Reading:
        """Returns the last reading of an IMU, a bumper or the battery.

        Args:
            sensor: name of the sensor, such as ``imu``.
            robot: name of the robot; None = the first robot.

        Raises:
            ConfigError: the sensor does not exist, or it has not measured yet.
        """
        name = self._robot_name(robot)
        last_reading = self._readings.get((name, sensor))
        if last_reading is None:
            known = list(self._suites[name].misses)
            if sensor in known:
                raise ConfigError(f"sensor {quoted(sensor)} of robot {quoted(name)} has not measured yet: step first")
            raise ConfigError(f"robot {quoted(name)} has no sensor {quoted(sensor)}; it has: {', '.join(known) or 'none'}")
        return last_reading

    # Cameras

    @property
    def light(self) -> LightSpec:
        """Light of the scene; assign ``dataclasses.replace(sim.light, sun=0.2, ...)`` to change it."""
        return self._light

    @light.setter
    def light(self, light: LightSpec) -> None:
        self._set_light(light)

    def _set_light(self, light: LightSpec) -> None:
        self._check_open()
        if not isinstance(light, LightSpec):
            raise ConfigError(f"light is {quoted(light)}, must be a LightSpec: dataclasses.replace(sim.light, sun=0.2)")
        self._light = light
        self._inputs.append((self.world.step_count, "_set_light", (light,)))

    @property
    def renderer(self) -> Renderer:
        """The renderer, with the current scene; created on first access.

        Raises:
            RenderError: no EGL device can render, or another thread has rendered before.
        """
        return self._renderer_of(self._drawn_now()[0])

    def render(
        self,
        camera: str | CameraSpec = "",
        outputs: Sequence[Output] | None = None,
        previous: SceneState | None = None,
        *,
        fill: str | os.PathLike[str] | None = None,
    ) -> Frame:
        """Returns the image of a camera at the current state.

        Args:
            camera: name of a camera or a view, or a camera spec; empty = the first camera.
            outputs: one or several of ``gibson_sim.OUTPUTS``; None = those of the camera's spec.
            previous: an earlier state, which ``flow`` and motion blur of cameras with a shutter need.
            fill: method that fills holes of the colours: ``push_pull``, ``learned`` or the path of an ONNX file, with ``,depth`` of depth,
                too; ``none`` or an empty string; None = as the camera's spec has it.

        Returns:
            The frame. Row 0 is the top; H, W are the camera's. ``rgb`` (H, W, 3) uint8, sRGB. ``depth`` (H, W) float32, metres along the
            optical axis, +inf = nothing, with the camera's ``depth_noise``. ``semantic``, ``instance`` (H, W) uint16: numbers in
            ``semantic_classes`` and ``instances``. ``normal`` (H, W, 3) float32, optical frame (x right, y down, z forward), and
            ``normal_world``. ``position`` (H, W, 3) float32, world frame, metres, NaN = nothing. ``flow`` (H, W, 2) float32, pixels right
            and down since ``previous``. ``hole`` (H, W) uint8, see ``Frame``. Outputs that were not requested are None.
            ``stamp_ns`` is that of the state; ``T_world_camera`` (4, 4) takes the optical frame to the world.

        Raises:
            ConfigError: the camera or output does not exist, ``flow`` has no previous state, or holes cannot be filled.
            RenderError: no EGL device can draw.
        """
        return self.render_all([camera], outputs, previous, fill=fill)[0]

    def render_all(
        self,
        cameras: Sequence[str | CameraSpec] = (),
        outputs: Sequence[Output] | None = None,
        previous: SceneState | None = None,
        *,
        fill: str | os.PathLike[str] | None = None,
    ) -> list[Frame]:
        """Returns the frames of several cameras, drawn together, which is faster than one by one; none given = all. See ``render``."""
        renderer, state, specs, before = self._render_arguments(cameras, outputs, previous, fill)
        frames = renderer.render(state, specs, before)
        return [apply_depth_noise(frame, frame.camera.depth_noise) for frame in frames]

    def render_tensors(
        self,
        cameras: Sequence[str | CameraSpec] = (),
        outputs: Sequence[Output] | None = None,
        previous: SceneState | None = None,
        *,
        fill: str | os.PathLike[str] | None = None,
    ) -> list[TensorFrame]:
        """Returns the frames of ``render_all`` as PyTorch tensors, without depth noise: on the GPU that drew them if CUDA supports it, else on
        the CPU.

        Raises:
            ConfigError: PyTorch is not installed, or the camera does not exist.
        """
        renderer, state, specs, before = self._render_arguments(cameras, outputs, previous, fill)
        return renderer.render_tensors(state, specs, before)

    def close(self) -> None:
        """Frees engine and renderer; a second call does nothing."""
        self._closed = True
        renderer, self._renderer = self._renderer, None
        try:
            if renderer is not None:
                renderer.close()
        finally:
            self.world.close()

    def __repr__(self) -> str:
        if self._closed:
            return "<Simulation: closed>"
        scene = self.world.scene
        return (
            f"<Simulation {scene.name}: {self.time:.3f} s, robots {', '.join(self.robots) or 'none'}, {len(scene.bodies)} bodies>"
        )

    def __enter__(self) -> Simulation:
        self._check_open()
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None) -> None:
        self.close()

    # Internals

    def _check_open(self) -> None:
        if self._closed:
            raise PhysicsError("this simulation is closed; create a new one")

    def _identity(self) -> tuple[Any, ...]:
        """Returns what a saved run depends on besides its inputs."""
        scene = self._initial
        return scene.name, scene.content_hash, scene.robots, self.world.step_hz, self._tick_hz, self._seed, self._command_timeout

    def _robot_name(self, name: str | None) -> str:
        names = [robot.name for robot in self.world.scene.robots]
        if name is None and names:
            return names[0]
        if name is None or name not in names:
            what = "no robot" if name is None else f"no robot {quoted(name)}"
            raise CommandError(f"{what} in this simulation; there are: {', '.join(names) or 'none'}")
        return name

    def _add_suites(self) -> None:
        for robot in self.world.scene.robots:
            if robot.name not in self._suites:
                suite = SensorSuite(robot, self.world.step_hz, self._tick_hz, self.world.scene.gravity, self._seed)
                suite.reset(self.world.step_count)
                self._suites[robot.name] = suite
                sensors = robot.sensors
                lidars = frozenset((*(planar.name for planar in sensors.lidars), *(other.name for other in sensors.lidars_3d)))
                self._measures_in_step[robot.name] = _all_but(lidars)  # `scan` measures these

    def _note(self, robot: str, measured: Measurements) -> None:
        readings: list[Reading] = [*measured.imus, *measured.bumpers, *measured.batteries]
        for reading in readings:
            self._readings[robot, reading.name] = reading

    def _drawn_now(self) -> tuple[DrawnScene, Views]:
        """Returns the scene to draw with its views; cached until something changes."""
        self._check_open()
        world = self.world
        if self._drawn is None or self._drawn[0] != world.scene.revision or self._drawn[1] is not self._light:
            robot = next((robot.name for robot in world.scene.robots), "")
            lit = replace(drawn_scene(world.scene, world.links), light=self._light)
            views = Views(self._view_specs, lit, robot, lambda: extent_of_scene(world.scene))
            if views.absent:
                raise ConfigError(next(iter(views.absent.values())))
            self._drawn = world.scene.revision, self._light, views.scene, views
        return self._drawn[2], self._drawn[3]

    def _renderer_of(self, drawn: DrawnScene) -> Renderer:
        from gibson_sim.render.cache import default_folder  # OpenGL with it
        from gibson_sim.render.renderer import MeshFiles, Renderer, RenderOptions

        if self._renderer is not None and self._loaded is drawn:
            return self._renderer
        if self._renderer is None:
            self._renderer = Renderer(drawn, meshes=MeshFiles(cache=default_folder()), options=RenderOptions(device=self._device))
        else:
            self._renderer.update(drawn)
        self._loaded = drawn
        for warning in self._renderer.warnings:
            logger.warning("%s", warning)
        return self._renderer

    def _render_arguments(
        self,
        cameras: Sequence[str | CameraSpec],
        outputs: Sequence[Output] | None,
        previous: SceneState | None,
        fill: str | os.PathLike[str] | None,
    ) -> tuple[Renderer, SceneState, list[CameraSpec], SceneState | None]:
        drawn, views = self._drawn_now()
        if isinstance(cameras, (str, CameraSpec)) or not isinstance(cameras, Sequence):
            raise ConfigError(f"cameras is {quoted(cameras)}, must be a list of names or cameras; `render` takes a single one")
        specs = [self._camera(drawn.cameras, camera) for camera in cameras] or list(drawn.cameras)
        if outputs is not None:
            requested = cast("tuple[Output, ...]", (outputs,) if isinstance(outputs, str) else tuple(outputs))
            specs = [replace(camera, outputs=requested) for camera in specs]
        if fill is not None:
            method, with_depth = parse_fill("fill", fill)
            specs = [
                replace(camera, fill=method, fill_depth=bool(method) and (with_depth or camera.fill_depth)) for camera in specs
            ]
        if previous is not None and not isinstance(previous, SceneState):
            raise ConfigError(f"previous is {quoted(previous)}, must be a state: what `step` returned, or `sim.state`")
        if previous is not None and previous.links != self.world.links:
            raise ConfigError("previous is a state with other things in it: take one from after the last spawn, remove or reset")
        if previous is None and any("flow" in camera.outputs for camera in specs):
            raise ConfigError("optical flow needs an earlier state: render(..., previous=state)")
        before = None if previous is None else views.extended(previous)
        return self._renderer_of(drawn), views.extended(self.world.state()), specs, before

    def _camera(self, known: Sequence[CameraSpec], camera: str | CameraSpec) -> CameraSpec:
        if isinstance(camera, CameraSpec):
            return camera
        if not isinstance(camera, str):
            raise ConfigError(f"camera is {quoted(camera)}, must be the name of one or a CameraSpec")
        views = {one.name for one in known}
        return self._one_of(known, f"view_{camera}" if camera not in views and f"view_{camera}" in views else camera, "camera")

    @staticmethod
    def _one_of(known: Sequence[T], name: str, what: str) -> T:
        """Returns the one with a name, or the first if the name is empty."""
        for one in known:
            if name in ("", one.name):
                return one
        names = [one.name for one in known]
        hint = nearest(name, names)
        raise ConfigError(
            f"there is no {what} {quoted(name)}; there are: {', '.join(names) or 'none'}{f'; {hint}' if hint else ''}"
        )


def _upright(position: Vec3, yaw: float) -> Pose:
    x, y, z = _numbers("position", position, "x, y and z in metres")
    return Pose((x, y, z), quat_from_rpy(0.0, 0.0, _number("yaw", yaw)))


def _number(what: str, value: Any) -> float:
    """Returns a number as float; raises ConfigError for text, None, flags and arrays."""
    if isinstance(value, (bool, np.bool_)) or not isinstance(value, (int, float, np.integer, np.floating)):
        raise ConfigError(f"{what} is {quoted(value)}, must be a number")
    return float(value)


def _numbers(what: str, values: Any, meaning: str) -> tuple[float, float, float]:
    if isinstance(values, str) or not isinstance(values, (Sequence, np.ndarray)) or len(values) != 3:
        raise ConfigError(f"{what} is {quoted(values)}, must be three numbers: {meaning}")
    first, second, third = (_number(what, value) for value in values)
    return first, second, third


def _view_size(size: Any) -> tuple[int, int]:
    whole = isinstance(size, (Sequence, np.ndarray)) and not isinstance(size, str) and len(size) == 2
    if whole and all(isinstance(side, (int, np.integer)) and not isinstance(side, bool) and side > 0 for side in size):
        return int(size[0]), int(size[1])
    raise ConfigError(f"view_size is {quoted(size)}, must be width and height in pixels, two whole numbers above 0")


class _ByName(dict[str, V]):
    """A dictionary that says which names there are where one is asked for that is not there."""

    def __init__(self, kind: str, values: Mapping[str, V]) -> None:
        super().__init__(values)
        self._kind = kind

    def __missing__(self, name: str) -> V:
        raise CommandError(f"no {self._kind} {quoted(name)} in this simulation; there are: {', '.join(self) or 'none'}")


def _all_but(names: frozenset[str]) -> Callable[[str], bool]:
    return lambda name: name not in names
