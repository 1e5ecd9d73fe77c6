"""The ROS 2 nodes: they convert messages, call the core, and publish. The only part of this package that imports rclpy."""
