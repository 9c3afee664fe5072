"""The command line of the scanner: one module a command, none of which is slow to import."""
