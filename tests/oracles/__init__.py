"""Second implementations in plain Python, NumPy, SciPy and mpmath; none of them imports the package."""
