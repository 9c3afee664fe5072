"""Stop under load, of a server that speaks TLS itself: what `benchmarks.stop` measures, over TLS.

Each connection of the loads begins with TLS's handshake, as every answer ends one; of the sockets with half a request
every other one says no word of TLS.
"""

from benchmarks.metric import Metric
from benchmarks.stop import under_loads


def measure(quick: bool) -> list[Metric]:
    """One Stop after the other under each load by itself and under all of them."""
    return under_loads(quick, "stop_tls", tls=True)
