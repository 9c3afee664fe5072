"""`python -m jaxscan`: the program `jaxscan`, where its script is not on the path."""

import sys

from jaxscan.cli.main import main

if __name__ == "__main__":
    sys.exit(main())
