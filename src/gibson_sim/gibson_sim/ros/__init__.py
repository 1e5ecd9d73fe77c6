"""The ROS 2 nodes; the only package that imports rclpy and message types. Each callback converts, calls the core, publishes."""
