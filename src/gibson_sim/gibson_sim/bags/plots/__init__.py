"""What happened in a recorded run: paths, velocities, contacts and rates, read from a bag and drawn as plots.

Must not import rclpy.
"""
