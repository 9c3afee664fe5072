"""Compiled functions kept from one command to the next: what JAX compiles once is read from disk afterwards."""

import os
from pathlib import Path


def keep_compiled() -> None:
    """Turn on JAX's persistent compilation cache, in the user's cache folder unless JAX is set to another."""
    import jax

    if jax.config.jax_compilation_cache_dir:  # pyright: ignore[reportAttributeAccessIssue]
        return
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    jax.config.update("jax_compilation_cache_dir", str(Path(base) / "jaxscan" / "compiled"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
