"""What any scientific program needs and no gyroscope: errors, units, files, tables, TOML, runtime, transforms."""
