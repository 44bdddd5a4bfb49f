"""The loop advanced a block of samples at a time."""
