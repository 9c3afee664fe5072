"""`python -m hardware.emulator bistep`: offer an emulated controller as a terminal until interrupted."""

import argparse
import contextlib
import threading

from hardware.emulator.port import EmulatedTerminal


def main() -> None:
    """Serve, and say where."""
    parser = argparse.ArgumentParser(prog="python -m hardware.emulator", description="An emulated controller.")
    parser.add_argument("controller", choices=("bistep", "grbl", "marlin"))
    parser.add_argument("--speed", type=float, default=1.0, help="times as fast as a real one (default: 1)")
    parser.add_argument("--faults", default="", help="as in the URL: drop=0.01&garble=0.01")
    args = parser.parse_args()
    url = f"emulator://{args.controller}?speed={args.speed:g}&{args.faults}"
    with contextlib.suppress(KeyboardInterrupt), EmulatedTerminal(url) as terminal:
        print(terminal.path, flush=True)
        threading.Event().wait()


if __name__ == "__main__":
    main()
