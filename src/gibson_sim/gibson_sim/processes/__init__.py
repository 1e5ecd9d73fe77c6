"""Node processes: environment, start and end, shared job folder, lock of the ROS domain, and cleanup after killed processes."""
