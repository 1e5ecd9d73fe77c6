"""Posed photographs of our scanner and of third-party programs: images, camera models, poses, depth. Reads files; independent of meshes."""
