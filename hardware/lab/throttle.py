"""How often somebody may try to sign in: guessing has to be slow, and mistyping must not shut anybody out for long.

Wrong tries by others shut nobody out of a browser in which they have signed in before: that browser has a cookie that
says so, and limits of its own (OWASP calls it a device cookie).
"""

import ipaddress
import logging
import sqlite3
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from typing import Final

from hardware.lab.database import Database
from hardware.lab.refusal import TOO_MANY, Refusal

# Limits (tries, seconds): one account from one address or known browser; one address; one account.
_HERE, _ADDRESS, _ACCOUNT = (5, 300.0), (30, 300.0), (100, 3600.0)
_LONGEST_S: Final = 3600.0
# Old tries are dropped each time that this number of tries has come.
_SWEEP: Final = 1000
_NETWORK_V6: Final = 64
_LOG: Final = logging.getLogger(__name__)


class Throttle:
    """Counts tries in memory; the database keeps them as far as its disk lets it, so that a restart forgets none."""

    def __init__(self, database: Database, now_s: Callable[[], float] = time.time):
        self._database, self._now_s = database, now_s
        self._mutex = threading.Lock()
        self._times: defaultdict[str, list[float]] = defaultdict(list)
        self._come = 0
        self._said: set[str] = set()
        for row in database.read("SELECT key, time_s FROM attempts ORDER BY time_s"):
            self._times[row["key"]].append(row["time_s"])

    def admit(self, name: str, address: str, browser: str = "") -> None:
        """Count a try before its password is looked at, so that many at once count too.

        Args:
            name: of the account.
            address: from which it comes.
            browser: which this account has signed in with before; "" for any other.

        Raises:
            Refusal: there were too many; says when to try again.
        """
        now_s = self._now_s()
        limits = _limits(name, address, browser)
        with self._mutex:
            self._sweep(now_s)
            for key, (most, within_s) in limits.items():
                # After a clock that was set back, tries of the future are of now.
                times = self._times[key] = [min(time_s, now_s) for time_s in self._times[key]]
                recent = [time_s for time_s in times if time_s > now_s - within_s]
                if len(recent) >= most:
                    # The one that has to grow old before another may come.
                    retry_s = recent[-most] + within_s - now_s
                    raise Refusal(TOO_MANY, f"too many tries to sign in: try again in {retry_s:.0f} s", retry_s)
            for key in limits:
                self._times[key].append(now_s)
        self._keep("INSERT INTO attempts VALUES (?, ?)", [(key, now_s) for key in limits])

    def forgive(self, name: str, address: str, browser: str = "") -> None:
        """Forget the tries for this account from here, and this one for the others: the password was right."""
        here, *others = _limits(name, address, browser)
        with self._mutex:
            self._times.pop(here, None)
            for key in others:
                if self._times[key]:
                    self._times[key].pop()
        self._keep("DELETE FROM attempts WHERE key = ?", [(here,)])
        self._keep(
            "DELETE FROM attempts WHERE rowid = (SELECT max(rowid) FROM attempts WHERE key = ?)",
            [(key,) for key in others],
        )

    def _sweep(self, now_s: float) -> None:
        self._come += 1
        if self._come % _SWEEP == 1:
            old_s = now_s - _LONGEST_S
            for key in [key for key, times in self._times.items() if not times or times[-1] < old_s]:
                del self._times[key]
            self._keep("DELETE FROM attempts WHERE time_s < ?", [(old_s,)])

    def _keep(self, sql: str, rows: list[tuple[str | float, ...]]) -> None:
        try:
            with self._database.together():
                for row in rows:
                    self._database(sql, *row)
        except sqlite3.Error as error:
            # Once for each kind of fault: a log that says it for each try fills a disk too.
            if str(error) not in self._said:
                self._said.add(str(error))
                _LOG.warning("tries to sign in cannot be kept now: %s", error)


def _limits(name: str, address: str, browser: str) -> dict[str, tuple[int, float]]:
    account = name.casefold()
    if browser:
        return {f"browser {account} {browser}": _HERE}
    network = network_of(address)
    return {f"both {account} {network}": _HERE, f"address {network}": _ADDRESS, f"account {account}": _ACCOUNT}


def network_of(address: str) -> str:
    """What counts as one address: of IPv6 a whole network, in which everybody has as many as they like."""
    try:
        found = ipaddress.ip_address(address.split("%")[0])
    except ValueError:
        return address
    if found.version == 4:
        return str(found)
    if (mapped := found.ipv4_mapped) is not None:
        return str(mapped)
    return str(ipaddress.ip_network((found, _NETWORK_V6), strict=False))
