"""Numbers of the loop moved by gradient: what may move, the losses, the way down, the fate of each number."""
