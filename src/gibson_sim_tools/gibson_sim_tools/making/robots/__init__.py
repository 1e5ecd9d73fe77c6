"""Makes the meshes of ``arm_bot`` procedurally, without Blender."""
