"""`python -m jaxscan`: the program `jaxscan`, where its script is not on the path."""

from jaxscan.cli.main import entry

if __name__ == "__main__":
    entry()
