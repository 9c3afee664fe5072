"""What the commands that read cameras of other programs have in common: their arguments."""

import argparse

from jaxscan.cli.options import columns_and_rows


def add_camera_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare what a file may leave open: which camera of several, and the size of its image."""
    parser.add_argument("--name", metavar="CAM", help="which camera of a camchain of several: cam0, cam1, …")
    parser.add_argument(
        "--image-size",
        type=image_size,
        metavar="COLUMNSxROWS",
        help="size of the photographs, such as 640x480, for a camera file that leaves it out",
    )


def image_size(text: str) -> tuple[int, int]:
    """Columns and rows from a text such as 640x480."""
    if (size := columns_and_rows(text)) is None:
        raise argparse.ArgumentTypeError(f'"{text}" is no size: write columns and rows, such as 640x480')
    return size
