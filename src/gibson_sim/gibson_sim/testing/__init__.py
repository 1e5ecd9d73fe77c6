"""Simulations for the tests of a robot's software: started without a window in a free ROS domain, commanded and observed from Python.

``HeadlessSimulation`` is what the pytest fixture ``sim`` gives (``gibson_sim.pytest``); it works without pytest, too. Nothing here is loaded
before a test asks for a simulation.
"""
