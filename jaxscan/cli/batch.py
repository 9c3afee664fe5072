"""`jaxscan batch`: every scan of a tree to points."""

import argparse
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.detector_options import add_choice_argument, add_depths_argument, add_detector_argument, depths_of
from jaxscan.extras import extra

HELP: Final = "reconstruct every scan of a tree, here or on a cluster, and go on where it stopped"
EXAMPLE: Final = "jaxscan batch scans --rig rig.json -o clouds"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("scans", type=Path, metavar="SCANS", help="each folder in it that has a scan.toml is a scan")
    parser.add_argument("--rig", type=Path, required=True, help="the rig of all of them")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        required=True,
        metavar="OUT",
        help="where to: the scan a/b is written to OUT/a/b.ply",
    )
    parser.add_argument(
        "--ending", choices=(".ply", ".npz"), default=".ply", help="points or range images (default: .ply)"
    )
    parser.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help="of a Dask scheduler whose workers see the same files, as tcp://host:8786",
    )
    parser.add_argument(
        "--again", action="store_true", help="also what is there already, younger than scan, rig and options"
    )
    add_detector_argument(parser)
    add_choice_argument(parser)
    add_depths_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Find the scans, leave out what is done, reconstruct the others, and tell of each that failed."""
    import sys

    if args.scheduler:
        extra("cluster")
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import read_rig
    from jaxscan.reconstruction.batch import Options, find_tasks, held, run_batch

    tasks = find_tasks(args.scans, args.output, args.ending)
    warnings = [f"{args.rig}: {warning}" for warning in read_rig(args.rig).warnings]
    options = Options(args.detector, args.stripe, depths_of(args))
    done, failed = [], []
    with held(args.output, options) as made_with:
        to_do = [task for task in tasks if args.again or not task.is_done(args.rig, made_with)]
        with progress("reconstructing scans", len(to_do), "scan", elsewhere=args.scheduler is not None) as advance:
            for outcome in run_batch(to_do, args.rig, options, args.scheduler):
                of = {"scan": outcome.task.name}
                if outcome.points is None:
                    failed.append({**of, "reason": outcome.reason})
                    print(f"jaxscan: {outcome.reason}", file=sys.stderr)
                else:
                    made = {"path": str(outcome.task.output), "points": outcome.points}
                    done.append({**of, **made, "notes": list(outcome.notes)})
                advance(1)
    return {
        "kind": "batch",
        "path": str(args.output),
        "scans": len(tasks),
        "kept": len(tasks) - len(to_do),
        "done": done,
        "failed": failed,
        "warnings": warnings,
    }


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    kept, failed = result["kept"], result["failed"]
    return "\n".join(
        [
            f"{len(result['done'])} of {result['scans']} scans reconstructed into {result['path']}"
            + (f", {kept} were there already" if kept else "")
            + (f", {len(failed)} failed:" if failed else ""),
            *(f"  {one['scan']}: {one['reason']}" for one in failed),
            *(["run the same command again to try these again"] if failed else []),
            *(f"note: {one['scan']}: {note}" for one in result["done"] for note in one["notes"]),
            *(f"warning: {warning}." for warning in result["warnings"]),
        ]
    )
