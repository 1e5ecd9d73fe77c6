"""The trial node, which speaks to the stack under test, and the server that starts nodes quickly."""
