"""Maps of a scene's floors: where a robot of some size can go, how far it is, ways, free places, files. Knows no ROS and no physics."""
