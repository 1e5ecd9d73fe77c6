"""The errors that this package raises on purpose.

    GibsonSimError                 catch this one; its text is one line, fit for a user
      TextError                    a text is no YAML or no XML, or too large
      ConfigError                  a setting has an impossible value
      SceneError                   a scene cannot be loaded
        SceneNotFoundError         nothing is there, or nothing that we can read
        MeshError                  a mesh or a texture file is broken
        scenes.spawning.SpawnError something cannot be spawned; its code says why
        scenes.worlds.WorldError   a world cannot be listed or loaded; its code says why
      RobotError                   a robot description cannot be used
      CommandError                 a command cannot be executed (a NaN velocity)
      PhysicsError                 the physics engine refused
        StartError                 a robot would start inside of something
      RenderError                  the renderer refused
        GraphicsUnavailableError   no EGL, no usable device
        SceneMismatchError         a state belongs to another scene than the one loaded
      scanning.posed_rgbd.ScanError images of a scan cannot be read, written or fused
      RecordError                  a bag cannot be written or read
        bags.room.DiskFullError    the disk is full; the bag holds everything up to there
      WriteError                   a file cannot be written
      EnvironmentProblemError      ROS, Python or the machine lacks something; the text names the remedy
      AlreadyRunningError          another simulation owns this ROS domain
      LockstepError                a participant of lockstep is gone, or hangs

Messages say what, which value, what is allowed and what to do. They may quote a file; ``public`` never does. Nothing here imports
anything of this package but ``quoting``.
"""

from __future__ import annotations

from typing import TypeVar

from gibson_sim.quoting import clipped

_LONGEST = 4000
"""Characters of a message."""
_Error = TypeVar("_Error", bound="GibsonSimError")


class GibsonSimError(Exception):
    """Base of every error that this package raises on purpose."""

    public = ""
    """What a client may be told who may not see the files that the message quotes, nor where they lie; empty = nothing."""

    def __init__(self, message: str = "", *more: object) -> None:
        """Makes it; names and paths in a message may come from a file of strangers: it stays one line, and within bounds."""
        text = str(message)
        super().__init__(text if len(text) <= _LONGEST and text.isprintable() else clipped(text, _LONGEST), *more)

    def telling(self: _Error, public: str) -> _Error:
        """Returns the error itself, which now tells clients ``public``."""
        self.public = public
        return self


class TextError(GibsonSimError):
    """A text is not what it should be: no YAML, no XML, or more of it than is read."""


class ConfigError(GibsonSimError):
    """A setting has an impossible value."""


class SceneError(GibsonSimError):
    """A scene cannot be loaded."""


class SceneNotFoundError(SceneError):
    """Nothing is at the given place, or nothing that can be read as a scene."""


class MeshError(SceneError):
    """A mesh or a texture file is broken."""


class RobotError(GibsonSimError):
    """A robot description cannot be used."""


class CommandError(GibsonSimError):
    """A command cannot be executed."""


class PhysicsError(GibsonSimError):
    """The physics engine refused."""


class StartError(PhysicsError):
    """A robot would start inside of something."""


class RenderError(GibsonSimError):
    """The renderer refused."""


class GraphicsUnavailableError(RenderError):
    """This machine offers no EGL, or no device that can draw."""


class SceneMismatchError(RenderError):
    """A state belongs to another scene than the one that is loaded."""


class RecordError(GibsonSimError):
    """A bag cannot be written or read."""


class WriteError(GibsonSimError):
    """A file cannot be written: the disk is full, the folder may not be written."""


class EnvironmentProblemError(GibsonSimError):
    """ROS, Python or the machine lacks something; the message names the remedy."""


class AlreadyRunningError(GibsonSimError):
    """Another simulation owns this ROS domain."""


class LockstepError(GibsonSimError):
    """A participant of lockstep has not done a tick in time."""
