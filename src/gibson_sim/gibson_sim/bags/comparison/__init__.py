"""Two bags side by side, a real robot's and a simulated one's: what differs, and what in the ``robot.yaml`` would bring them closer.

Each metric is a pure function on arrays; ``load`` alone reads bags, ``plots`` alone draws. Must not import rclpy.
"""
