"""`--detector`, `--stripe` and `--depths`: how a stripe is measured, which is taken of several, and where it can be."""

import argparse

from jaxscan.cli.options import not_nan, numbers
from jaxscan.detectors import CHOICES, DEFAULT, DEFAULT_CHOICE, DETECTORS


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
        default=DEFAULT_CHOICE,
        metavar="RULE",
        help="which is taken where a column shows several, reflections or two lit surfaces "
        f"(default: {DEFAULT_CHOICE}): {_words(CHOICES)}",
    )


def add_depths_argument(parser: argparse.ArgumentParser) -> None:
    """Declare `--depths`."""
    parser.add_argument(
        "--depths",
        type=numbers(2, not_nan, "numbers"),
        metavar="NEAR,FAR",
        help="how near and how far along the optical axis (of a fisheye, from the camera) there can be a stripe, mm; "
        "anything bright elsewhere is ignored (default: from 1 / 1.5 of the nearest to 1.5 times the farthest stripe "
        "of "
        "the calibration; 0,inf: anywhere)",
    )


def depths_of(args: argparse.Namespace) -> tuple[float, float] | None:
    """What `--depths` says."""
    return None if args.depths is None else (args.depths[0], args.depths[1])


def _words(names: dict) -> str:
    return ", ".join(f"{name} ({words})" for name, words in names.items())
