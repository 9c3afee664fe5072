"""`jaxscan batch`: every scan of a tree to points."""

import argparse
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.detector_options import add_choice_argument, add_depths_argument, add_detector_argument, depths_of
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxscan.files.part_file import Part
    from jaxscan.reconstruction.batch import Task

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
    from jaxscan.cli.progress import progress, say
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
                    say(f"jaxscan: {outcome.reason}")
                else:
                    made = {"path": str(outcome.task.output), "points": outcome.points}
                    done.append({**of, **made, "notes": list(outcome.notes)})
                advance(1)
    measured = {} if part is None else _measured(args, tasks, part)
    return {
        "kind": "batch",
        "path": str(args.output),
        "scans": len(tasks),
        "kept": len(tasks) - len(to_do),
        "done": done,
        "failed": failed,
        "warnings": warnings,
        **measured,
    }


def _measured(args: argparse.Namespace, tasks: "Sequence[Task]", part: "Part") -> dict[str, Any]:
    """Every scan that is there, as `jaxscan measure` has it; the table and the charts are written."""
    from jaxscan.cli.measure import read_surface
    from jaxscan.cli.progress import say, step
    from jaxscan.files.measured_csv import write_scans_csv
    from jaxscan.measurement.measure import measure
    from jaxscan.measurement.rows import rows_of

    scans, verdicts = {}, {}
    for task in tasks:
        if not task.output.exists():
            continue
        step(f"measuring {task.name}")
        try:
            found = measure(read_surface(task.output, args.rig)[0], part)
        except InputError as error:
            say(f"jaxscan: {error}")
            continue
        scans[task.name], verdicts[task.name] = rows_of(found), found.verdict
    written = []
    if scans:
        write_scans_csv(args.output / "measured.csv", scans)
        written.append(str(args.output / "measured.csv"))
        if find_spec("matplotlib") is not None and part.dimensions:
            from jaxscan.view.measured_part import control_charts

            control_charts(args.output / "measured.png", scans)
            written.append(str(args.output / "measured.png"))
    dimensions = [{"scan": scan, "verdict": verdicts[scan], "dimensions": rows} for scan, rows in scans.items()]
    return {"measured": dimensions, "written": written}


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    kept, failed = result["kept"], result["failed"]
    return "\n".join(
        [
            f"{len(result['done'])} of {result['scans']} scans reconstructed into {result['path']}"
            + (f", {kept} were there already" if kept else "")
            + (f", {len(failed)} failed:" if failed else ""),
            *(f"  {one['scan']}: {one['reason']}" for one in failed),
            *_table(result),
            *(["run the same command again to try these again"] if failed else []),
            *(f"note: {one['scan']}: {note}" for one in result["done"] for note in one["notes"]),
            *(f"warning: {warning}." for warning in result["warnings"]),
        ]
    )


def _table(result: dict[str, Any]) -> list[str]:
    """What was measured: of each scan a line, and where the table and the charts are."""
    if not result.get("measured"):
        return []
    from jaxscan.measurement.rows import value_in_words

    lines = []
    for each in result["measured"]:
        cells = "; ".join(f"{row['name']} {value_in_words(row)}" for row in each["dimensions"])
        lines.append(f"  {each['scan']}: {cells}")
    return [*lines, f"written: {', '.join(result['written'])}"]
