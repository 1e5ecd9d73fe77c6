"""Maps of a scene's floors: traversability, paths, tours, rooms, named and free poses, and their files. Knows no ROS and no physics engine."""
