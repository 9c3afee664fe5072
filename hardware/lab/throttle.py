"""How often somebody may try to sign in: guessing has to be slow, and mistyping must not shut anybody out for long."""

import time
from collections.abc import Callable
from typing import Final

from hardware.lab.database import Database
from hardware.lab.refusal import TOO_MANY, Refusal

# For one account from one address, for one address, for one account: so many within so many seconds.
_HERE, _ADDRESS, _ACCOUNT = (5, 300.0), (30, 300.0), (100, 3600.0)
_LONGEST_S: Final = 3600.0


class Throttle:
    """Counts tries in the database, so that a restart forgets none."""

    def __init__(self, database: Database, now_s: Callable[[], float] = time.time):
        self._database, self._now_s = database, now_s

    def admit(self, name: str, address: str) -> None:
        """Count a try before its password is looked at, so that many at once count too.

        Raises:
            Refusal: there were too many; says when to try again.
        """
        now_s = self._now_s()
        limits = self._limits(name, address)
        with self._database.together():
            self._database("DELETE FROM attempts WHERE time_s < ?", now_s - _LONGEST_S)
            for key, (most, within_s) in limits.items():
                # The one that has to grow old before another may come.
                times = self._database(
                    "SELECT time_s FROM attempts WHERE key = ? AND time_s > ? ORDER BY time_s DESC LIMIT 1 OFFSET ?",
                    key,
                    now_s - within_s,
                    most - 1,
                )
                if times:
                    retry_s = times[0]["time_s"] + within_s - now_s
                    raise Refusal(TOO_MANY, f"too many tries to sign in: try again in {retry_s:.0f} s", retry_s)
            for key in limits:
                self._database("INSERT INTO attempts VALUES (?, ?)", key, now_s)

    def forgive(self, name: str, address: str) -> None:
        """Forget the tries for this account from here, and this one for the others: the password was right."""
        here, *others = self._limits(name, address)
        with self._database.together():
            self._database("DELETE FROM attempts WHERE key = ?", here)
            for key in others:
                self._database(
                    "DELETE FROM attempts WHERE rowid = (SELECT max(rowid) FROM attempts WHERE key = ?)", key
                )

    @staticmethod
    def _limits(name: str, address: str) -> dict[str, tuple[int, float]]:
        account = name.casefold()
        return {f"both {account} {address}": _HERE, f"address {address}": _ADDRESS, f"account {account}": _ACCOUNT}
