"""What each command of `memsgyro` does once its words are understood: one file a command."""
