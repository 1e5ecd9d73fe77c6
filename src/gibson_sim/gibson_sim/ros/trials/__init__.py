"""The trial node, which communicates with the stack under test, and the server that starts nodes quickly."""
