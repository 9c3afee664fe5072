"""What the examples work on: photographs that `jaxscan simulate` makes once, and the rig that they give.

Every example takes a folder as its only argument, `jaxscan-examples` by default. It reads `world/session` and
`world/scan` in it, and leaves its results beside them. Put photographs of your own there, described by a `session.toml`
and a `scan.toml`, and the examples work on those.
"""

import sys
from pathlib import Path

import jaxscan
from jaxscan.cli.compiled import keep_compiled
from jaxscan.cli.main import main

keep_compiled()  # what JAX compiles for one example, the next reads from disk, as the commands do


def folder() -> Path:
    """Where photographs are and results go."""
    if len(sys.argv) > 2 or any(word.startswith("-") for word in sys.argv[1:]):
        sys.exit(f"usage: python {sys.argv[0]} [FOLDER]\n\n{sys.modules['__main__'].__doc__}")
    out = Path(sys.argv[1] if len(sys.argv) > 1 else "jaxscan-examples")
    out.mkdir(parents=True, exist_ok=True)
    return out


def world() -> Path:
    """The folder of photographs, simulated if it is not there: about a minute."""
    out = folder() / "world"
    if not out.is_dir() and main(["simulate", str(out)]) != 0:
        sys.exit(f"{out}: could not be simulated")
    return out


def calibration() -> jaxscan.Calibration:
    """What example 1 is about, in three lines."""
    session = jaxscan.read_session(world() / "session")
    camera = session.camera
    return jaxscan.calibrate(
        jaxscan.observe(session), lens=camera.lens, principal_point=camera.principal_point, hold=camera.hold
    )


def rig() -> jaxscan.RigFile:
    """The rig that example 1 leaves, or the same made now."""
    path = folder() / "rig.json"
    if not path.exists():
        jaxscan.write_rig(path, calibration().rig_file())
    return jaxscan.read_rig(path)
