"""Many dies: the spread of fabrication, the sweep, its store and summary, and what the spread does (sensitivity)."""
