"""`python -m hardware`: the program `scanner`, where its script is not on the path."""

import sys

from hardware.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
