"""The whole of the ``simulation_interfaces`` standard without ROS: states, entities, stepping, resets, worlds.

Values go in, values come out, and a ``SimulationError`` carries the result code of the standard. ``ros/services/simulation_services.py`` puts
services and an action around it. Knows neither ROS nor PyBullet; time and randomness are given.
"""
