"""Other processes of the server: this Python, with the packages that this process has found."""

import os
import subprocess
import sys
from typing import Any, cast


def begin(module: str, *arguments: str, **how: Any) -> "subprocess.Popen[bytes]":
    """Begin `python -m MODULE`; `how` is what `subprocess.Popen` takes besides, for bytes."""
    argv = [sys.executable, "-m", module, *arguments]
    env = {**os.environ, "PYTHONPATH": os.pathsep.join(path or os.getcwd() for path in sys.path)}
    return cast("subprocess.Popen[bytes]", subprocess.Popen(argv, env=env, **how))
