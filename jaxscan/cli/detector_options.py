"""`--detector` and `--stripe`: how a stripe's centre is measured, and which is taken of several."""

import argparse

from jaxscan.detectors import CHOICES, DEFAULT, DETECTORS


def add_detector_argument(parser: argparse.ArgumentParser) -> None:
    """Declare `--detector`."""
    parser.add_argument(
        "--detector",
        choices=tuple(DETECTORS),
        default=DEFAULT,
        metavar="NAME",
        help=f"how the stripe's centre is measured (default: {DEFAULT}): {_words(DETECTORS)}",
    )


def add_choice_argument(parser: argparse.ArgumentParser) -> None:
    """Declare `--stripe`."""
    parser.add_argument(
        "--stripe",
        choices=tuple(CHOICES),
        default="strongest",
        metavar="RULE",
        help="which is taken where a column shows several, reflections or two lit surfaces "
        f"(default: strongest): {_words(CHOICES)}",
    )


def _words(names: dict) -> str:
    return ", ".join(f"{name} ({words})" for name, words in names.items())
