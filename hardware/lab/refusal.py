"""What the lab refuses, with the status that HTTP has for it."""

from typing import Final

WRONG: Final = 400
SIGN_IN: Final = 401
FORBIDDEN: Final = 403
NOT_THERE: Final = 404
CONFLICT: Final = 409
MISDIRECTED: Final = 421
WRONG_VALUE: Final = 422
TOO_MANY: Final = 429
FULL: Final = 503


class Refusal(Exception):  # noqa: N818 (it is no error: the lab works as it should)
    """A request that is not granted: its text says why, and what would be.

    Attributes:
        status: of the answer.
        retry_s: when to ask again, where that is known.
    """

    def __init__(self, status: int, words: str, retry_s: float | None = None):
        super().__init__(words)
        self.status, self.retry_s = status, retry_s
