"""Compiled functions are kept from one command to the next, whatever happens to the files."""

import os
import subprocess
import sys
from pathlib import Path

# As a command does it: two functions, of which JAX says in a warning each where it cannot read or keep one.
_COMMAND = """
import jax
from jaxscan.cli.compiled import keep_compiled
from jaxscan.cli.main import Program, _warnings_in_words
with _warnings_in_words(Program("jaxscan", "", {})):
    keep_compiled()
    print(jax.jit(lambda x: x + 1)(1.0), jax.jit(lambda x: x * 2)(1.0))
"""


def said(cache: Path) -> str:
    """What such a command prints on the standard error."""
    env = {name: value for name, value in os.environ.items() if not name.startswith("JAX_")}
    env |= {"XDG_CACHE_HOME": str(cache), "JAX_PLATFORMS": "cpu"}
    run = subprocess.run([sys.executable, "-c", _COMMAND], env=env, capture_output=True, text=True, timeout=120)
    assert run.returncode == 0, run.stderr
    assert run.stdout == "2.0 2.0\n"
    return run.stderr


def test_half_written_ones_are_written_again(tmp_path: Path) -> None:
    assert said(tmp_path) == ""
    kept = {path: path.read_bytes() for path in (tmp_path / "jaxscan" / "compiled").glob("jit_*")}
    assert len(kept) >= 2
    for path, content in kept.items():
        path.write_bytes(content[:100])
    assert said(tmp_path) == ""
    for path, content in kept.items():
        assert len(path.read_bytes()) > len(content) / 2


def test_a_folder_that_cannot_be_written_is_named_once(tmp_path: Path) -> None:
    no_folder = tmp_path / "file"
    no_folder.touch()
    (line,) = said(no_folder).splitlines()
    assert line.startswith(f"jaxscan: warning: {no_folder}/jaxscan/compiled: what is compiled cannot be kept there (")
    assert line.endswith("make room, or set XDG_CACHE_HOME to a folder that can be written")


def test_a_full_disk_is_named_once_and_leaves_nothing_half_written(tmp_path: Path) -> None:
    # As JAX says it where a disk is full.
    script = """
import os
from pathlib import Path
import jax
from jaxscan.cli.compiled import cache_warning, keep_compiled
keep_compiled()
folder = Path(jax.config.jax_compilation_cache_dir)
folder.mkdir(parents=True)
for age, name in enumerate(("jit_g-1-cache", "jit_f-0-cache", "jit_g-0-cache")):
    (folder / name).write_bytes(b"half of it")
    os.utime(folder / name, (0, 1000 - age))
for name in "fg":
    print(cache_warning(f"Error writing persistent compilation cache entry for 'jit_{name}': "
                        "OSError: [Errno 28] No space left on device"))
print(sorted(path.name for path in folder.iterdir()), cache_warning("another"))
"""
    env = os.environ | {"XDG_CACHE_HOME": str(tmp_path)}
    env.pop("JAX_COMPILATION_CACHE_DIR", None)
    run = subprocess.run([sys.executable, "-c", script], env=env, capture_output=True, text=True, timeout=120)
    first, second, rest = run.stdout.splitlines()
    assert f"{tmp_path}/jaxscan/compiled: what is compiled cannot be kept there (No space left on device)" in first
    assert second == "None"
    assert rest == "['jit_g-0-cache'] another"
