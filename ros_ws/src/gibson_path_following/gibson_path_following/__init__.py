"""Follows a recorded path by camera images alone: nodes for a real robot, without any import of the simulator."""

__version__ = "0.1.0"
