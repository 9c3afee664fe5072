"""Time and memory of the whole demo, as a user starts it."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

import psutil

from benchmarks.metric import Metric


def measure(quick: bool) -> list[Metric]:
    """One run of `jaxscan demo`; left out of a quick run, where the tests have run it."""
    if quick:
        return []
    with tempfile.TemporaryDirectory() as folder:
        begin = time.monotonic()
        command = [sys.executable, "-m", "jaxscan", "demo", "-o", str(Path(folder) / "demo")]
        process = psutil.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        peak = 0
        while process.poll() is None:
            try:
                peak = max(peak, process.memory_info().rss)
            except psutil.NoSuchProcess:
                break
            time.sleep(0.1)
        seconds = time.monotonic() - begin
        if process.returncode:
            raise RuntimeError(f"jaxscan demo ended with status {process.returncode}")
    return [
        Metric("demo.seconds", seconds, "s", "lower", 90, slack=0.5),
        Metric("demo.memory", peak / 2**30, "GiB", "lower", 4, slack=0.2),
    ]
