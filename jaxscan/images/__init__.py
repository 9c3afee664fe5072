"""Photographs to observations: decoding, the board's corners, the laser stripe, and pictures of what was found."""

from jaxscan.images.board import Board
from jaxscan.images.decode import image_size, read_image, read_video, to_grey, write_image
from jaxscan.images.find import BoardView, find_board
from jaxscan.images.order import carry_order
from jaxscan.images.overlay import draw_board, draw_stripe
from jaxscan.images.second_board import second_board
from jaxscan.images.stripes.detect import Stripe, StripeSettings, detect_stripe

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
    "second_board",
    "to_grey",
    "write_image",
]
