"""The command line: one module a command, none of which is slow to import."""
