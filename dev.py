"""The commands of this repository, each doing its own set-up: `python3 dev.py --help`.

Python 3.11 or later is all that has to be there. The first command makes the virtual environment `.venv` and installs
into it the versions that `constraints.txt` pins.
"""

import argparse
import contextlib
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent
VENV = ROOT / ".venv"
BIN = VENV / ("Scripts" if os.name == "nt" else "bin")

# Compiled functions that no run has read for so long are deleted, s.
_KEPT_S = 14 * 24 * 3600

# command: what it needs installed, what it runs, what it is for
COMMANDS = {
    "demo": (
        "plots,viewer",
        ["jaxscan", "demo"],
        "simulate a scanner, calibrate it, scan a panda, compare with the truth",
    ),
    "test": ("dev", ["pytest"], "run the tests"),
    "lint": ("dev", ["ruff", "check"], "check the style, then the words"),
    "words": ("dev", ["python", "docs/words"], "check spelling, phrases, and how easy the pages are to read"),
    "format": ("dev", ["ruff", "format"], "put the style right"),
    "types": ("dev", ["pyright"], "check the types"),
    "contract": ("dev", ["lint-imports"], "check which part imports which"),
    "docs": ("docs", ["mkdocs", "build"], "build the documentation, into site/"),
    "bench": ("dev", ["python", "-m", "benchmarks"], "run the benchmarks"),
    "newest": ("dev", ["pytest"], "run the tests with the newest packages on 3.11, 3.12 and 3.13, those that are here"),
}
# The versions of Python that `newest` looks for, and the tests that it runs: without the hardware and the servers.
PYTHONS = ("3.11", "3.12", "3.13")
CORE = ("tests", "--ignore=tests/hardware", "--ignore=tests/test_install.py")

# What answers --help with nothing installed.
_OWN = {"demo": ["-m", "jaxscan", "demo"], "bench": ["-m", "benchmarks"]}


def main() -> int:
    """Set up what the command needs, then run it with the rest of the command line."""
    parser = argparse.ArgumentParser(
        description="Set up and run. What follows the command is handed on to it.",
        epilog="\n".join(f"  {name:9} {words}" for name, (_, _, words) in COMMANDS.items()),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("command", choices=COMMANDS)
    parser.add_argument("rest", nargs=argparse.REMAINDER, help="what the command is given")
    args = parser.parse_args()
    extra, command, _ = COMMANDS[args.command]
    if sys.version_info < (3, 11):  # noqa: UP036 (this file is what says so to an older Python)
        print(f"Python 3.11 or later is needed; this is {sys.version.split()[0]}", file=sys.stderr)
        return 2
    if args.command in _OWN and {"-h", "--help"} & set(args.rest):
        return subprocess.run([sys.executable, *_OWN[args.command], "--help"], cwd=ROOT).returncode
    try:
        if args.command == "newest":
            return newest(args.rest)
        set_up(extra)
    except subprocess.CalledProcessError as error:
        print(f"set-up failed: {' '.join(map(str, error.cmd))}", file=sys.stderr)
        if not (BIN / "pip").exists():
            print("Python's own venv is missing; on Debian: apt-get install python3-venv", file=sys.stderr)
        return 1
    # What a user's own command compiles belongs to the user's cache, where the next command looks for it.
    env = _compiled_once() if extra == "dev" else None
    status = subprocess.run([BIN / command[0], *command[1:], *args.rest], cwd=ROOT, env=env).returncode
    if args.command == "lint" and not args.rest:
        _, words, _ = COMMANDS["words"]
        status = subprocess.run([BIN / words[0], *words[1:]], cwd=ROOT).returncode or status
    return status


def newest(versions: list[str]) -> int:
    """Run the core's tests on each version of Python that this machine has, with the newest packages that pip finds.

    Args:
        versions: all that are known if empty.

    Returns:
        0 where all passed that were found, and one was.
    """
    failed, tested = 0, 0
    for version in versions or PYTHONS:
        python = python_of(version)
        if python is None:
            print(f"Python {version}: not on this machine, not tested", flush=True)
            continue
        venv = ROOT / f".venv-{version}"
        programs = venv / BIN.name
        if not (programs / "pip").exists():
            subprocess.run([python, "-m", "venv", venv], check=True)
        install = [programs / "python", "-m", "pip", "install", "--quiet", "--disable-pip-version-check", "--upgrade"]
        subprocess.run([*install, "--upgrade-strategy", "eager", "--editable", ".[dev]"], cwd=ROOT, check=True)
        said = "import jax, sys; print(f'Python {sys.version.split()[0]}, JAX {jax.__version__}', flush=True)"
        subprocess.run([programs / "python", "-c", said], cwd=ROOT, check=True)
        failed |= subprocess.run([programs / "pytest", *CORE], cwd=ROOT, env=_compiled_once(version)).returncode
        tested += 1
    return failed or int(not tested)


def python_of(version: str) -> str | None:
    """A Python of a version, as 3.12: on the path, or of pyenv; None where this machine has none."""
    pyenv = Path(os.environ.get("PYENV_ROOT") or Path.home() / ".pyenv") / "versions"
    for path in (shutil.which(f"python{version}"), *sorted(pyenv.glob(f"{version}.*/bin/python"), reverse=True)):
        # The path may have a shim of pyenv, which runs only what is chosen.
        if path is not None and subprocess.run([path, "-c", ""], capture_output=True).returncode == 0:
            return str(path)
    return None


def _compiled_once(version: str = "") -> dict[str, str]:
    """The environment, and where JAX keeps what one test or benchmark has compiled for the others, and for later runs.

    What is compiled depends on versions and on the processor, so each combination has a folder of its own, outside the
    checkout: a fresh clone need not compile again. What no run has read for two weeks is deleted.
    """
    base = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jaxscan" / "tests"
    # With a version of Python the packages are the newest, whatever the pins.
    pins = version.encode() if version else (ROOT / "constraints.txt").read_bytes()
    versions = pins, sys.version.encode(), _processor()
    folder = base / hashlib.sha256(b"".join(versions)).hexdigest()[:16]
    for path in base.glob("*/*"):
        with contextlib.suppress(OSError):  # another run may have deleted it
            if time.time() - path.stat().st_atime > _KEPT_S:
                path.unlink()
    kept = {"JAX_COMPILATION_CACHE_DIR": str(folder), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0"}
    env = kept | dict(os.environ)
    # Otherwise each of pytest's processes would compile each module and rewrite each test in each run.
    env.pop("PYTHONDONTWRITEBYTECODE", None)
    return env


def _pins() -> list[bytes]:
    return [(ROOT / name).read_bytes() for name in ("pyproject.toml", "constraints.txt")]


def _processor() -> bytes:
    """What code is compiled for: on Linux the processor's features, elsewhere its name."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    features = next((line for line in lines if line.startswith(("flags", "Features"))), "")
    return f"{platform.machine()} {platform.processor()} {features}".encode()


def set_up(extra: str) -> None:
    """Install the package with one of its extras, unless that was done for these very pins."""
    done = VENV / f".installed-{extra}-{hashlib.sha256(b''.join(_pins())).hexdigest()[:16]}"
    if done.exists():
        return
    if not (BIN / "pip").exists():
        subprocess.run([sys.executable, "-m", "venv", VENV], check=True)
    print(f"setting up {VENV} (once; a few minutes with a slow network)", file=sys.stderr)
    install = [BIN / "python", "-m", "pip", "install", "--disable-pip-version-check"]
    # Whoever waits sees that it moves; a log need not.
    install += [] if sys.stderr.isatty() else ["--quiet"]
    subprocess.run(
        [*install, "--constraint", "constraints.txt", "--editable", f".[{extra}]"], cwd=ROOT, check=True, stdout=2
    )
    done.touch()


if __name__ == "__main__":
    try:
        sys.exit(main())
    except KeyboardInterrupt:  # what was running has had it too
        sys.exit(130)
