"""Photographs to observations: decoding, the board's corners, the laser stripe, and pictures of what was found.

What needs JAX is imported when it is first asked for, so that reading or writing a scan folder does not wait for it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from jaxscan.images.board import Board
from jaxscan.images.decode import image_size, read_image, read_video, to_grey, write_image
from jaxscan.images.order import carry_order
from jaxscan.images.overlay import draw_board, draw_stripe
from jaxscan.images.stripe_settings import StripeSettings

if TYPE_CHECKING:
    from jaxscan.images.find import BoardView, find_board, shows_checkerboard
    from jaxscan.images.second_board import shows_second_board
    from jaxscan.images.stripes.detect import detect_stripe
    from jaxscan.images.stripes.stripe import Stripe

_WITH_JAX = {
    "BoardView": "jaxscan.images.find",
    "Stripe": "jaxscan.images.stripes.stripe",
    "detect_stripe": "jaxscan.images.stripes.detect",
    "find_board": "jaxscan.images.find",
    "shows_second_board": "jaxscan.images.second_board",
    "shows_checkerboard": "jaxscan.images.find",
}

__all__ = [
    "Board",
    "BoardView",
    "Stripe",
    "StripeSettings",
    "carry_order",
    "detect_stripe",
    "draw_board",
    "draw_stripe",
    "find_board",
    "image_size",
    "read_image",
    "read_video",
    "shows_checkerboard",
    "shows_second_board",
    "to_grey",
    "write_image",
]


def __getattr__(name: str) -> Any:
    if name not in _WITH_JAX:
        raise AttributeError(f"module 'jaxscan.images' has no attribute '{name}'")
    return getattr(import_module(_WITH_JAX[name]), name)
