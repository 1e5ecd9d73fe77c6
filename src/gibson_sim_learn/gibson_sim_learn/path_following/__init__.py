"""Following a path by images: the split of the scenes, randomised domains, drives without ROS, data, network, training."""
