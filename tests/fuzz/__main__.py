"""Mutated files for every reader: `python -m tests.fuzz --cases 20000`; prints how they ended, and fails on a fault."""

import argparse
import sys
import time
from collections import Counter
from pathlib import Path

from tests.fuzz.campaign import case, run, shares
from tests.fuzz.limits import Bench
from tests.fuzz.seeds import TARGETS


def main() -> int:
    """Run the cases."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cases", type=int, default=500, help="of all readers together (500)")
    parser.add_argument("--from", type=int, default=0, dest="first", help="the number of each reader's first case (0)")
    parser.add_argument("--only", nargs="*", choices=TARGETS, help="these readers alone")
    parser.add_argument("--write", metavar="FOLDER", type=Path, help="write the bad cases there")
    parser.add_argument("--shown", type=int, default=4, help="bad cases shown of each reader (4)")
    args = parser.parse_args()
    total: Counter[str] = Counter()
    begun = time.monotonic()
    with Bench() as bench:
        for name, share in shares(args.cases):
            if args.only and name not in args.only:
                continue
            tally = run(bench, name, range(args.first, args.first + share))
            total += tally.outcomes
            words = ", ".join(f"{count} {outcome}" for outcome, count in sorted(tally.outcomes.items()))
            print(f"{name:14} {words}; at most {tally.longest_s:.2f} s, {tally.most_bytes / 2**20:.0f} MiB", flush=True)
            for number, verdict in tally.bad[: args.shown]:
                print(f"    {name} {number}: {verdict.outcome}: {verdict.said}")
            if args.write and tally.bad:
                _write(args.write, name, [number for number, _ in tally.bad])
    count = total.total()
    print(f"{count} cases in {time.monotonic() - begun:.0f} s: {total['read']} read, {total['refused']} refused")
    print(f"foreign exceptions {total['foreign']}, hangs {total['hang']}, hungry {total['hungry']}")
    return 1 if total["foreign"] + total["hang"] + total["hungry"] else 0


def _write(folder: Path, name: str, numbers: list[int]) -> None:
    own = folder / name
    own.mkdir(parents=True, exist_ok=True)
    seed = TARGETS[name].seed(own)
    for number in numbers:
        (own / f"{number}{Path(TARGETS[name].file).suffix}").write_bytes(case(name, number, seed))


if __name__ == "__main__":
    sys.exit(main())
