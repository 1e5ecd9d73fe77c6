"""The meshes of our mobile manipulator: made from a few numbers, without Blender."""
