"""What stands on the path: free space, ways around, speeds."""
