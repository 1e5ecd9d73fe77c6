"""Drawing with OpenGL: the scene in GPU memory, light, materials, cameras of every projection, and camera effects."""
