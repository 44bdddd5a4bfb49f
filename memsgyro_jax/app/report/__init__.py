"""Pages that a person reads: one self-contained HTML file each, built from results that draw and print themselves."""
