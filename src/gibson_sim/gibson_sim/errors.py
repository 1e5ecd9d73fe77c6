"""Errors that this package raises on purpose.

    GibsonSimError                 the base class; its message is one line for a user
      TextError                    a text is neither YAML nor XML, or too large
      ConfigError                  a setting has an invalid value
        trials.scenario.load.ScenarioError  a scenario file is invalid, or cannot be met
      SceneError                   a scene cannot be loaded
        SceneNotFoundError         a file does not exist, or is not a scene
        MeshError                  a mesh or a texture file is corrupt
        scenes.spawning.SpawnError a resource cannot be spawned; its code is the reason
        scenes.worlds.WorldError   a world cannot be listed or loaded; its code is the reason
      RobotError                   a robot description cannot be used
      CommandError                 a command cannot be executed (a NaN velocity)
      PhysicsError                 the physics engine rejected a request
        StartError                 a robot would start in collision
      RenderError                  the renderer cannot render
        GraphicsUnavailableError   no EGL, no usable device
        SceneMismatchError         a state does not belong to the loaded scene
      ScanError                    images of a scan cannot be read, written or fused; in gibson_sim_tools.scanning
      RecordError                  a bag cannot be written or read
        bags.folders.DiskFullError the disk is full; the bag contains all earlier messages
      WriteError                   a file cannot be written
      EnvironmentProblemError      a component of ROS, Python or the machine is missing; the message names the remedy
      AlreadyRunningError          another simulation uses this ROS domain
      LockstepError                a lockstep participant has exited or hangs

Messages name the object, the value, the allowed values and the remedy. They may quote a file; ``public`` never does. Imports only ``quoting``.
"""

from __future__ import annotations

from typing import TypeVar

from gibson_sim.quoting import clipped

_MAX_LENGTH = 4000
"""Maximum length of a message, characters."""
_Error = TypeVar("_Error", bound="GibsonSimError")


class GibsonSimError(Exception):
    """Base class of all errors that this package raises on purpose."""

    public = ""
    """Message for clients that may see neither the files that the message quotes nor their paths; empty = none."""

    def __init__(self, message: str = "", *more: object) -> None:
        """Limits the message to one line of limited length, since it may quote names and paths from untrusted files."""
        text = str(message)
        super().__init__(text if len(text) <= _MAX_LENGTH and text.isprintable() else clipped(text, _MAX_LENGTH), *more)

    def with_public(self: _Error, public: str) -> _Error:
        """Sets ``public`` and returns the error itself."""
        self.public = public
        return self


class TextError(GibsonSimError):
    """A text is neither YAML nor XML, or too large."""


class ConfigError(GibsonSimError):
    """A setting has an invalid value."""


class SceneError(GibsonSimError):
    """A scene cannot be loaded."""


class SceneNotFoundError(SceneError):
    """A file does not exist, or is not a scene."""


class MeshError(SceneError):
    """A mesh or a texture file is corrupt."""


class RobotError(GibsonSimError):
    """A robot description cannot be used."""


class CommandError(GibsonSimError):
    """A command cannot be executed."""


class PhysicsError(GibsonSimError):
    """The physics engine rejected a request."""


class StartError(PhysicsError):
    """A robot would start in collision."""


class RenderError(GibsonSimError):
    """The renderer cannot render."""


class GraphicsUnavailableError(RenderError):
    """This machine has no EGL, or no device that can render."""


class SceneMismatchError(RenderError):
    """A state does not belong to the loaded scene."""


class RecordError(GibsonSimError):
    """A bag cannot be written or read."""


class WriteError(GibsonSimError):
    """A file cannot be written, for example because the disk is full or the folder is read-only."""


class EnvironmentProblemError(GibsonSimError):
    """A component of ROS, Python or the machine is missing; the message names the remedy."""


class AlreadyRunningError(GibsonSimError):
    """Another simulation uses this ROS domain."""


class LockstepError(GibsonSimError):
    """A lockstep participant has not finished a tick in time."""


_PIP_NAMES = {
    "cuda": "cuda-bindings", "cv2": "opencv-python-headless", "foxglove": "foxglove-sdk", "pxr": "usd-core", "ruamel": "ruamel-yaml",
    "yaml": "PyYAML",
}  # fmt: skip
"""Module -> PyPI package, where the names differ."""
_OWN_PACKAGES = ("gibson_sim", "gibson_sim_tools", "gibson_sim_learn", "gibson_sim_bench", "gibson_path_following")
_ROS_PACKAGES = ("rclpy", "rpyutils", "ament_index_python", "launch", "launch_ros")


def missing_package(error: ImportError) -> EnvironmentProblemError | None:
    """Returns the error for a package that is not installed, with its remedy; None if the import failed for another reason.

    Args:
        error: error of an import statement.
    """
    module = (error.name or "").partition(".")[0]
    if not isinstance(error, ModuleNotFoundError) or not module or module in _OWN_PACKAGES:
        return None
    if module in _ROS_PACKAGES or module.endswith(("_msgs", "_interfaces", "_srvs")):
        apt = "" if module == "gibson_msgs" else f"`sudo apt install ros-jazzy-{module.replace('_', '-')}`, or "
        return EnvironmentProblemError(
            f"the ROS package {module} is not found: {apt}build ros_ws and source its install/setup.bash; without a ROS installation: `make setup`"
        )
    return EnvironmentProblemError(
        f"the Python package {_PIP_NAMES.get(module, module)} is not installed: `pip install {_PIP_NAMES.get(module, module)}`"
    )
