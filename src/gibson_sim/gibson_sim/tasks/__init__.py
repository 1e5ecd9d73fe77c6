"""Tasks for a robot that drives and manipulates: seeded episodes, goals, metrics, scripted baselines, Gymnasium environments.

Only ``run.py`` and ``pictures.py`` use a simulation, and only ``environments.py`` imports Gymnasium; the rest is pure. No ROS.
"""
