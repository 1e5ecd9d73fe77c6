"""Simulations for tests of a robot's software: started without a window in a free ROS domain, controlled and observed from Python.

The pytest fixture ``sim`` (``gibson_sim.pytest``) is a ``HeadlessSimulation``, which also works without pytest. This package is imported only
when a test requests a simulation.
"""
