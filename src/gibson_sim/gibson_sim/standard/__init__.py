"""The ``simulation_interfaces`` standard without ROS: states, entities, stepping, resets, worlds.

Functions take and return values; a ``SimulationError`` carries the result code of the standard. ``ros/services/simulation_services.py``
provides them as services and an action. Imports neither ROS nor PyBullet; time and randomness are arguments.
"""
