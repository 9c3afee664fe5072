"""A process that reads mutated files one by one, and says of each how it ended.

The reader runs as it does in the tests: shapes checked, warnings errors. A warning that names the file is our own.
Requests and answers are lines of JSON on standard input and output; whatever ends the process is for `limits` to see.
"""

import importlib
import json
import os
import resource
import sys
import time
import traceback
import warnings
from pathlib import Path
from typing import Any

GIB = 1 << 30
_ROOT = Path(__file__).parents[2]
# Beyond what a case may take, so that it is measured; short of what would take the machine down with it.
_MORE_AT_MOST = 6 * GIB


def main() -> None:
    """Answer until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # decoders print
    readers = _readers(sys.argv[1])
    in_use = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (in_use + _MORE_AT_MOST, resource.RLIM_INFINITY))
    print("{}", file=answers, flush=True)
    for line in sys.stdin:
        request = json.loads(line)
        print(json.dumps(_answer(readers[request["reader"]], Path(request["path"]))), file=answers, flush=True)


def _readers(module: str) -> Any:
    from jaxtyping import install_import_hook

    checked = [f"jaxscan.{part}" for part in ("geometry", "rig", "calibration", "reconstruction")]
    install_import_hook(checked, "beartype.beartype")
    return importlib.import_module(module).READERS


def _answer(read: Any, path: Path) -> dict[str, Any]:
    from hardware.errors import HardwareError
    from jaxscan.errors import InputError

    Path("/proc/self/clear_refs").write_text("5")  # the peak is that of this case
    before, start = _memory("VmRSS"), time.process_time()
    outcome, said = "read", ""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            warnings.filterwarnings("ignore", message=f"^{path.parent}")
            read(path)
    except (InputError, HardwareError) as error:
        outcome, said = "refused", str(error)
        if str(path.parent) not in said:
            outcome = "foreign"
            said = f"does not name the file: {said}"
    except BaseException as error:  # noqa: BLE001 (what it is, is what is asked)
        outcome, said = "foreign", _in_words(error)
    took_s = time.process_time() - start
    return {"outcome": outcome, "said": said[:400], "took_s": took_s, "grew": _memory("VmHWM") - before}


def _in_words(error: BaseException) -> str:
    """With the last place of ours that it passed."""
    ours = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename.startswith(str(_ROOT))]
    where = [frame for frame in ours if "/.venv/" not in frame.filename][-1]
    return f"{type(error).__name__} at {Path(where.filename).name}:{where.lineno}: {error}"


def _memory(key: str) -> int:
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(key):
            return int(line.split()[1]) * 1024
    raise AssertionError(key)


if __name__ == "__main__":
    main()
