"""Maps of a scene's floors: traversability, paths, tours, rooms, named and free poses, and their files. Must not import ROS or a physics engine."""
