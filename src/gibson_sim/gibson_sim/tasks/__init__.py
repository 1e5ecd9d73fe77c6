"""Tasks in which a robot moves things: where they begin, what is wanted, how well it went, and who does it by a script.

Pure but for ``run.py``, which has a world of physics, and ``environments.py``, which alone has Gymnasium. No ROS.
"""
