"""`jaxscan batch`: every scan of a tree to points."""

import argparse
import errno
import os
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.batch_log import TABLE, Log, notes_in_words
from jaxscan.cli.batch_measured import measured_in_words, measured_scans
from jaxscan.cli.detector_options import add_choice_argument, add_depths_argument, add_detector_argument, depths_of
from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.missing import listed

if TYPE_CHECKING:
    from jaxscan.reconstruction.batch import Task
    from jaxscan.reconstruction.records import Record

# After this number of scans in a row that found no room no other is begun.
_FULL_IN_A_ROW: Final = 4

HELP: Final = "reconstruct every scan of a tree, here or on a cluster, and continue where it stopped"
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
        "--again",
        action="store_true",
        help="make results again that are there already, from the same scan, rig and options",
    )
    parser.add_argument(
        "--measure",
        type=Path,
        metavar="PART",
        help="measure each scan by this part.toml: a line for each in OUT/measured.csv, and control charts in "
        "OUT/measured.png where matplotlib is installed; takes --ending .npz",
    )
    add_detector_argument(parser)
    add_choice_argument(parser)
    add_depths_argument(parser)


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Find the scans, leave out what is done, reconstruct the others, and report each that failed."""
    if args.scheduler:
        extra("cluster")
    if args.measure and args.ending != ".npz":
        raise InputError(
            f"--measure {args.measure}: intervals need range images, and --ending is {args.ending}: add --ending .npz"
        )
    part = None
    if args.measure:
        from jaxscan.files.part_file import read_part

        part = read_part(args.measure)
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.files.rig_file import read_rig
    from jaxscan.reconstruction.batch import Options, find_tasks, held

    tree = find_tasks(args.scans, args.output, args.ending)
    warnings = [f"{args.rig}: {warning}" for warning in read_rig(args.rig).warnings]
    with held(args.output):
        log = Log.begun(args.output / TABLE, tree, args.rig, Options(args.detector, args.stripe, depths_of(args)))
        try:
            _reconstructed(args, log)
        finally:
            log.write()
        measured = {} if part is None else measured_scans(args.output, args.rig, part, log)
    return {
        "kind": "batch",
        "path": str(args.output),
        "scans": len(tree.tasks) + len(tree.refused),
        "kept": len(log.kept),
        "done": [_in_json(task, log.records[task.name]) for task in tree.tasks if task.name in log.made],
        "there": [_in_json(task, log.records[task.name]) for task in tree.tasks if task.name in log.kept],
        "failed": [{"scan": scan, "reason": reason} for scan, reason in log.failed.items()],
        "table": str(log.path),
        "warnings": warnings,
        **measured,
    }


def _reconstructed(args: argparse.Namespace, log: "Log") -> None:
    """All scans whose results are not there, into the log."""
    from jaxscan.cli.progress import progress, say
    from jaxscan.reconstruction.batch import run_batch

    to_do = [task for task in log.tree.tasks if args.again or task.name not in log.kept]
    log.kept -= {task.name for task in to_do}
    elsewhere, at_work, full = args.scheduler is not None, set[str](), 0
    with progress("reconstructing scans", len(to_do), "scan", elsewhere, at_work) as advance:
        for outcome in run_batch(to_do, args.rig, log.options, args.scheduler, at_work):
            log.add(outcome)
            if outcome.record is None:
                say(f"jaxscan: {outcome.reason}")
            advance(1)
            full = full + 1 if os.strerror(errno.ENOSPC) in outcome.reason else 0
            if full == _FULL_IN_A_ROW:
                say("jaxscan: the disk is full: make room, then run the same command again for the remaining scans")
                break


def _in_json(task: "Task", record: "Record") -> dict[str, Any]:
    counts = {"points": record.points, "frames": record.frames, "empty": record.empty}
    return {"scan": task.name, "path": str(task.output), **counts, "notes": list(record.notes)}


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    kept, failed = result["kept"], result["failed"]
    there = [*result["done"], *result["there"]]
    bare = [f"{one['scan']} {one['empty']} of {one['frames']}" for one in there if one["empty"]]
    return "\n".join(
        [
            f"{len(result['done'])} of {result['scans']} scans reconstructed into {result['path']}"
            + (f", {kept} were there already" if kept else "")
            + (f", {len(failed)} failed:" if failed else ""),
            *(f"  {one['scan']}: {one['reason']}" for one in failed),
            *measured_in_words(result),
            *(["run the same command again to try these again"] if failed else []),
            *([f"photographs without a point: {listed(bare, 'and')}"] if bare else []),
            *notes_in_words(there),
            *(f"warning: {warning}." for warning in result["warnings"]),
            f"each scan has a line in {result['table']}",
        ]
    )
