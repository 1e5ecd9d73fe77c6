"""Where the robot is along a path, from images and odometry."""
