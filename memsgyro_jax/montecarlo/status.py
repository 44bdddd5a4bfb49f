"""What became of a die: a column of every lot. Stores are read and written by it without JAX."""

STATUS = "status"  # name of the column
PENDING, OK, LOST, DIVERGED = -1, 0, 1, 2
MEANING = {
    PENDING: "pending",
    OK: "ok",
    LOST: "lost (out of travel or not finite)",
    DIVERGED: "diverged (impossible under what its filter claims)",
}
