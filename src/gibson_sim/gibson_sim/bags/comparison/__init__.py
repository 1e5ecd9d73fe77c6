"""Compares the bag of a real robot with that of a simulated one, and fits values of the ``robot.yaml`` that reduce the differences.

Each metric is a pure function on arrays; only ``load`` reads bags, only ``plots`` draws. Must not import rclpy.
"""
