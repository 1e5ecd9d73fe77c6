"""Path folders: how they are recorded, read and measured."""
