"""`python -m hardware`: the program `scanner`, where its script is not on the path."""

from hardware.cli.main import entry

if __name__ == "__main__":
    entry()
