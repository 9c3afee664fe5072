"""Compiled functions kept from one command to the next: what JAX compiles once is read from disk afterwards.

JAX says when it looks for a compiled function, and when it has one; in between it compiles, or reads it from disk.
"""

import contextlib
import glob
import os
import re
import time
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.process import owned

_ASKED: Final = "/jax/compilation_cache/compile_requests_use_cache"
_THERE: Final = "/jax/core/compile/backend_compile_duration"
# Reading a function from disk takes less.
_READ_S: Final = 0.3

# What JAX warns of: name is that of a compiled function, which its files begin with.
_FAILED: Final = re.compile(r"Error (reading|writing) persistent compilation cache entry for '(.*?)': (?s:(.*))")
# Of an error its class, its number and the file; what went wrong is said between them.
_REASON: Final = re.compile(r"\w+: (?:\[Errno \d+\] )?(.*?)(?:: '.*')?", re.DOTALL)

# When each of those that are waited for was asked for. Appending and popping need no lock.
_waited_for: list[float] = []
_listening = False
_said = False


def keep_compiled() -> None:
    """Turn on JAX's persistent compilation cache, in the user's cache folder unless JAX is set to another.

    A process that is one of our programs keeps there what it has traced, too.
    """
    import jax

    from jaxscan import kept_programs

    _listen()
    folder = jax.config.jax_compilation_cache_dir  # pyright: ignore[reportAttributeAccessIssue]
    if not folder:
        base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
        folder = str(Path(base) / "jaxscan" / "compiled")
        jax.config.update("jax_compilation_cache_dir", folder)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    if owned() and "://" not in folder:
        kept_programs.keep(Path(folder))


def compiling() -> bool:
    """Whether JAX is compiling a function now, which it reads from disk the next time."""
    return any(time.monotonic() - asked > _READ_S for asked in tuple(_waited_for))


def cache_warning(message: str) -> str | None:
    """What is said in place of a warning: where JAX has not read or kept a compiled function, what to do, at most once.

    JAX compiles again what it cannot read, and never replaces the file: one that was half written, as a full disk or a
    sudden end leaves it, would stand in the way for ever. It is deleted, and then written again.

    Args:
        message: of the warning.

    Returns:
        The words; None where there is nothing to say.
    """
    global _said
    failed = _FAILED.fullmatch(message)
    if failed is None:
        return message
    import jax

    folder = Path(str(jax.config.jax_compilation_cache_dir))  # pyright: ignore[reportAttributeAccessIssue]
    doing, name, reason = failed.groups()
    files = list(folder.glob(f"{glob.escape(name)}-*")) if folder.is_dir() else []
    if doing == "writing":
        # The one that could not be written whole.
        files = sorted(files, key=_written)[-1:]
    for file in files:
        with contextlib.suppress(OSError):
            file.unlink()
    if _said or (doing == "reading" and folder.is_dir()):
        return None
    _said = True
    why = _REASON.fullmatch(reason)
    return (
        f"{folder}: what is compiled cannot be kept there ({why[1] if why else reason}), and each command compiles it "
        "again: make room, or set XDG_CACHE_HOME to a folder that can be written"
    )


def _written(file: Path) -> float:
    try:
        return file.stat().st_mtime
    except OSError:  # another process has deleted it
        return 0.0


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
