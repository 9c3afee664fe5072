"""Compiled functions whose programs are kept on disk: a process reads them, and need not trace Python again.

JAX keeps what it has compiled, and finds it by its program. But to know the program it traces and lowers the function,
which is half of what a command takes before its first profile. Here the lowered program is kept too (`jax.export`). Its
file is found by all that decides what is traced: the source of jaxscan, the versions of Python and of the libraries
that take part, JAX's settings, the platform, what is static, and shapes and dtypes of the rest.

It is off until a process that runs jaxscan and nothing else turns it on (`keep`). Who changes a function while Python
runs, as a test does, must not be given what was traced before.

Kept or not, a program is compiled with options that halve the time that this takes on a CPU (`_options`).
"""

import contextlib
import functools
import hashlib
import inspect
import pickle
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final, NamedTuple

import equinox as eqx
import jax
import jax.export
import numpy as np
from jax.core import Tracer

from jaxscan.atomic import replacing
from jaxscan.errors import InputError

# What else than jaxscan's own source is traced, or traces.
_LIBRARIES: Final = ("jax", "jaxlib", "numpy", "equinox", "optimistix", "lineax")
_DIGEST: Final = 32
_ARRAYS: Final = (jax.Array, np.ndarray, np.generic)
# XLA has two ways of writing a fused kernel. The newer one takes each kernel through MLIR, which is half of what our
# programs take to compile; what the older one writes runs as fast.
_FAST_TO_COMPILE: Final = {"xla_cpu_use_fusion_emitters": False}
# What stands for an array among leaves; what the `repr` of an object has that says no more than where it is.
_ARRAY: Final = "an array"
_BY_PLACE: Final = " at 0x"

_folder: Path | None = None


def keep(folder: Path) -> None:
    """Keep programs in a folder from now on, and read those that are there."""
    global _folder
    _folder = folder


def compiled(
    *, static_argnames: str | Sequence[str] = (), filtered: bool = False
) -> Callable[[Callable[..., Any]], "Compiled"]:
    """`jax.jit` for a function of one of jaxscan's modules that takes long to trace; its program may be kept.

    Args:
        static_argnames: as `jax.jit` has them; their values must have a `repr` that says all of them.
        filtered: whether all that is no array is static too, as with `eqx.filter_jit`.
    """
    static = (static_argnames,) if isinstance(static_argnames, str) else tuple(static_argnames)
    return lambda function: Compiled(function, static, filtered)


class _Ready(NamedTuple):
    """A program that can be called with the arrays that are given, and the shape of what comes back."""

    program: Callable[..., list[jax.Array]]
    shape: Any


class _Form(NamedTuple):
    """All of what is given but the numbers in its arrays.

    Attributes:
        static: arguments by their names.
        tree: of the others.
        rest: its leaves, `_ARRAY` in place of arrays.
        avals: of the arrays.
        x64: whether numbers have 64 bits by default.
    """

    static: tuple[tuple[str, Any], ...]
    tree: Any
    rest: tuple[Any, ...]
    avals: tuple[Any, ...]
    x64: bool

    def with_arrays(self, arrays: Sequence[jax.Array]) -> dict[str, Any]:
        """What was given, with these arrays."""
        each = iter(arrays)
        leaves = [next(each) if leaf is _ARRAY else leaf for leaf in self.rest]
        return jax.tree.unflatten(self.tree, leaves) | dict(self.static)


class Compiled:
    """A compiled function whose program may be kept.

    Attributes:
        within: the same as `jax.jit` makes it, for use within another function that is traced.
    """

    def __init__(self, function: Callable[..., Any], static: tuple[str, ...], filtered: bool) -> None:
        self._function, self._static, self._filtered = function, static, filtered
        # As with `jax.jit`, plain numbers among its arguments are no less free than arrays.
        self._free: tuple[type, ...] = _ARRAYS if filtered else (*_ARRAYS, bool, int, float)
        self.within: Any = self._jitted()
        self._signature = inspect.signature(function)
        self._ready: dict[_Form, _Ready | None] = {}
        self._preparing = threading.Lock()
        functools.update_wrapper(self, function)

    @functools.cached_property
    def jitted(self) -> Any:
        """The same as `jax.jit` makes it with `_options`, for processes that keep nothing."""
        return self._jitted(compiler_options=_options())

    def _jitted(self, **options: Any) -> Any:
        if self._filtered:
            return eqx.filter_jit(self._function, **options)
        return jax.jit(self._function, static_argnames=self._static, **options)

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        """What the function gives."""
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((args, kwargs))):
            return self.within(*args, **kwargs)
        # Where another function is traced, what is known is computed, and not made a part of it.
        with jax.ensure_compile_time_eval():
            return self.jitted(*args, **kwargs) if _folder is None else self._kept(_folder, args, kwargs)

    def _kept(self, folder: Path, args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        """What the function gives, by its kept program if there can be one."""
        given = self._signature.bind(*args, **kwargs)
        given.apply_defaults()
        static = tuple((name, given.arguments.pop(name)) for name in self._static)
        leaves, tree = jax.tree.flatten(dict(given.arguments))
        arrays = [leaf for leaf in leaves if isinstance(leaf, self._free)]
        if len(arrays) < len(leaves) and not self._filtered:
            return self.jitted(*args, **kwargs)
        rest = tuple(_ARRAY if isinstance(leaf, self._free) else leaf for leaf in leaves)
        x64 = jax.config.jax_enable_x64  # pyright: ignore[reportAttributeAccessIssue]
        form = _Form(static, tree, rest, tuple(map(jax.typeof, arrays)), x64)
        if form not in self._ready:
            with self._preparing:
                if form not in self._ready:
                    self._ready[form] = self._prepared(folder, form)
        ready = self._ready[form]
        if ready is None:
            return self.jitted(*args, **kwargs)
        return jax.tree.unflatten(ready.shape, ready.program(*arrays))

    def _prepared(self, folder: Path, form: _Form) -> _Ready | None:
        """The program for what has this form; None where it cannot be kept."""
        name = self._function.__name__
        words = repr((self._function.__module__, name, *form[:1], str(form.tree), *form[2:], _settings()))
        # Of a function, for one, its name does not say what it does. Several devices share work as the arrays say.
        if _BY_PLACE in words or jax.device_count() > 1:
            return None
        path = folder / f"{name}-{hashlib.sha256(_source() + words.encode()).hexdigest()}.program"
        kept = _read(path)
        if kept is None:
            kept = self._lowered(form)
            if kept is None:
                return None
            with contextlib.suppress(InputError, OSError):  # JAX says where nothing can be kept
                _write(path, kept)
        content, back = kept
        exported = jax.export.deserialize(bytearray(content))

        def program(*arrays: jax.Array) -> Any:
            return exported.call(*arrays)

        # By which JAX's own files, and what it says of a function, are called.
        program.__name__ = name
        # What a kept program gives is committed to its device, what NumPy gives is not. Without a place that is named
        # JAX would compile the same program again for each combination of the two.
        [device] = jax.devices()
        one_place = jax.sharding.SingleDeviceSharding(device)
        ready = jax.jit(program, in_shardings=one_place, compiler_options=_options())
        return _Ready(ready, jax.tree.structure(back))

    def _lowered(self, form: _Form) -> tuple[bytes, Any] | None:
        """The program, and the tree that it gives, with numbers for leaves; None where it cannot be written."""
        shape: Any = None

        def flat(*arrays: jax.Array) -> list[jax.Array]:
            nonlocal shape
            out, shape = jax.tree.flatten(self._function(**form.with_arrays(arrays)))
            return out if all(isinstance(leaf, _ARRAYS) for leaf in out) else []

        try:
            exported = jax.export.export(jax.jit(flat))(*form.avals)
        except (ValueError, NotImplementedError):  # of a device's own functions JAX promises nothing from day to day
            return None
        # More than arrays came back.
        if len(exported.out_avals) != shape.num_leaves:
            return None
        return bytes(exported.serialize()), jax.tree.unflatten(shape, range(shape.num_leaves))


@functools.cache
def _options() -> dict[str, bool] | None:
    """XLA's options for our programs; None elsewhere than on a CPU, and where this XLA does not know them."""
    if jax.default_backend() != "cpu":
        return None
    try:
        jax.jit(lambda x: x + 1, compiler_options=_FAST_TO_COMPILE)(1)
    except jax.errors.JaxRuntimeError:
        return None
    return dict(_FAST_TO_COMPILE)


def _read(path: Path) -> tuple[bytes, Any] | None:
    """What is kept in a file; None where there is none that is whole."""
    try:
        content = path.read_bytes()
    except OSError:
        return None
    digest, content = content[:_DIGEST], content[_DIGEST:]
    # Whoever can write into this folder can have any command run what it likes: JAX's own files there are native code.
    return pickle.loads(content) if hashlib.sha256(content).digest() == digest else None


def _write(path: Path, kept: tuple[bytes, Any]) -> None:
    content = pickle.dumps(kept)
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, durable=False) as file:
        file.write(hashlib.sha256(content).digest() + content)


@functools.cache
def _source() -> bytes:
    """A digest of all that is the same in a process: jaxscan's source, versions, the platform."""
    digest = hashlib.sha256()
    package = Path(__file__).parent
    for path in sorted(package.rglob("*.py")):
        digest.update(str(path.relative_to(package)).encode() + path.read_bytes())
    digest.update(repr((sys.version, [version(name) for name in _LIBRARIES], jax.default_backend())).encode())
    return digest.digest()


def _settings() -> list[tuple[str, Any]]:
    """JAX's settings, without those that only say where it keeps what it has compiled."""
    return sorted((name, value) for name, value in jax.config.values.items() if "cache" not in name)
