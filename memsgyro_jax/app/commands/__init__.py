"""What each command of `memsgyro` does: one file a command, which imports what it runs inside its function."""
