"""OpenGL drawing: the scene in GPU memory, lighting, materials, cameras of every projection, and camera effects."""
