"""Renders a scene off-screen: EGL contexts, GPU buffers, RGB and depth. The only package that uses OpenGL."""
