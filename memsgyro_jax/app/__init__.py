"""What a person at a terminal touches: the command line, study files, report pages."""
