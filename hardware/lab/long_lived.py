"""What stays for as long as the server: set aside, so that no collection of garbage looks at it again.

A full collection looks at every object of the process, and lets no other thread have the interpreter meanwhile. With
JAX and the web framework loaded that took 0.2 s on idle cores and 0.5 to 0.75 s on busy ones; Stop waited for it.
"""

import gc


def set_aside(first: bool = False) -> None:
    """Let collections leave alone whatever there is now.

    Args:
        first: collect before; for a moment when nobody waits yet.
    """
    if first:
        gc.collect()
    gc.freeze()
