"""Compiled functions kept from one command to the next: what JAX compiles once is read from disk afterwards.

JAX says when it looks for a compiled function, and when it has one; in between it compiles, or reads it from disk.
"""

import os
import time
from pathlib import Path
from typing import Any, Final

_ASKED: Final = "/jax/compilation_cache/compile_requests_use_cache"
_THERE: Final = "/jax/core/compile/backend_compile_duration"
# Reading a function from disk takes less.
_READ_S: Final = 0.3

# When each of those that are waited for was asked for. Appending and popping need no lock.
_waited_for: list[float] = []
_listening = False


def keep_compiled() -> None:
    """Turn on JAX's persistent compilation cache, in the user's cache folder unless JAX is set to another."""
    import jax

    _listen()
    if jax.config.jax_compilation_cache_dir:  # pyright: ignore[reportAttributeAccessIssue]
        return
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(Path(base) / "jaxscan" / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)


def compiling() -> bool:
    """Whether JAX is compiling a function now, which it reads from disk the next time."""
    return any(time.monotonic() - asked > _READ_S for asked in tuple(_waited_for))


def _listen() -> None:
    """Have JAX say when it begins to compile and when it is done; once for a process."""
    global _listening
    if _listening:
        return
    _listening = True
    from jax import monitoring

    monitoring.register_event_listener(_begun)
    monitoring.register_event_duration_secs_listener(_done)


def _begun(event: str, **_: Any) -> None:
    if event == _ASKED:
        _waited_for.append(time.monotonic())


def _done(event: str, duration_secs: float, **_: Any) -> None:
    if event == _THERE and _waited_for:
        _waited_for.pop()
