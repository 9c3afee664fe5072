"""`jaxscan accept`: test a scanner by an artefact that is known better, and keep a history of the tests."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.atomic import make_folder
from jaxscan.cli.options import check_outputs
from jaxscan.cli.progress import step
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from jaxscan.measurement.accept import Acceptance

HELP: Final = "test a scanner by balls and planes of known size (ISO 10360-13), and draw its drift from test to test"
EXAMPLE: Final = (
    "jaxscan accept bar-1.npz bar-2.npz bar-3.npz --artefact artefact.toml --rig rig.json --history\n"
    "  jaxscan accept --history --png drift.png"
)
_HISTORY: Final = "acceptance.jsonl"
_HOW: Final = """\
which artefact goes where (places by VDI/VDE 2634 part 2, spread over the whole scanned volume):
  a ball       10 places   probing_form, probing_size    diameter about a tenth of the volume's diagonal
  a ball bar    7 places   distance                      along the edges and the diagonals, and upright
  a plane       6 places   flatness                      level, and leaning to each side
Each scan shows the whole artefact once, and nothing else of its size. With fewer places the figures hold, and it is
said. Balls are found by their diameters; dull, white ones are seen best. A plate with balls has all figures in one
scan: docs/accept.md shows one to print.
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.description = f"{parser.description}\n\n{_HOW}"
    parser.add_argument(
        "surface",
        type=Path,
        nargs="*",
        metavar="SURFACE",
        help="range images (.npz) of the artefact, one for each place; none: show only the history",
    )
    parser.add_argument(
        "--artefact", type=Path, metavar="FILE", help="artefact.toml: certified values, and the maker's limits"
    )
    parser.add_argument(
        "--rig",
        type=Path,
        help="the rig of the scans: it says where errors move a point to, and its covariance what errors to expect",
    )
    parser.add_argument(
        "--history",
        type=Path,
        nargs="?",
        const=Path(_HISTORY),
        metavar="FILE",
        help=f"add the test to this file (default: {_HISTORY}), or without SURFACE show how the figures have changed",
    )
    parser.add_argument(
        "--report", type=Path, metavar="DIR", help="write DIR/report.html, ready to print, and its JSON"
    )
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw the figures, or without SURFACE their drift")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read, test, and write; or read the history."""
    if args.png or args.report:
        extra("plots")
    if args.report:
        make_folder(args.report)
    inputs = [path for path in (*args.surface, args.artefact, args.rig) if path]
    if not args.surface:
        return _drift(args)
    if args.artefact is None:
        raise InputError("--artefact is missing: give the artefact.toml with the certified values of what was scanned")
    if args.rig is None:
        raise InputError("--rig is missing: give the rig of the scans; without it balls are measured too large")
    for path in args.surface:
        if path.suffix.lower() != ".npz":
            raise InputError(f"{path}: a scanner is tested by its range images: reconstruct to .npz")
    check_outputs([args.history] if args.history else [], args.png, inputs)
    from jaxscan.files.artefact_file import read_artefact

    artefact = read_artefact(args.artefact)
    if args.history and args.history.exists():
        from jaxscan.files.acceptance_history import read_history

        read_history(args.history)
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.errors import error_context
    from jaxscan.files.rig_file import read_rig
    from jaxscan.measurement.accept import accept
    from jaxscan.reconstruction import read_range_image

    rig = read_rig(args.rig)
    scans = []
    for path in args.surface:
        step(f"reading {path}")
        with error_context(path):
            scans.append((str(path), read_range_image(path)))
    step("measuring")
    found = accept(scans, rig, artefact)
    written = _written(args, found)
    return _as_result(found) | {"written": written, "warnings": list(rig.warnings)}


def _written(args: argparse.Namespace, found: "Acceptance") -> list[str]:
    """Add to the history, and draw."""
    from datetime import UTC, datetime

    from jaxscan.measurement.drift import as_test

    written = []
    if args.history and found.figures:
        from jaxscan.files.acceptance_history import add_to_history
        from jaxscan.files.digest import short_digest

        now = datetime.now(UTC).isoformat(timespec="seconds")
        certificate, rig = short_digest(args.artefact), short_digest(args.rig)
        add_to_history(args.history, as_test(found, now, certificate, rig))
        written.append(str(args.history))
    if args.png or args.report:
        from jaxscan.view.acceptance import acceptance_report, draw_acceptance, write_picture
        from jaxscan.view.report import write_report

        if args.png:
            write_picture(args.png, draw_acceptance(found))
            written.append(str(args.png))
        if args.report:
            files = {"scan": args.surface, "rig": [args.rig], "artefact": [args.artefact]}
            written += write_report(args.report, acceptance_report(found).recorded(files))
    return written


def _drift(args: argparse.Namespace) -> dict[str, Any]:
    if args.history is None:
        raise InputError("there is no SURFACE: name range images of the artefact, or --history to show earlier tests")
    if args.artefact or args.rig:
        raise InputError("--artefact and --rig belong to a test: name its range images too, or leave them out")
    check_outputs([], args.png, [args.history])
    from jaxscan.files.acceptance_history import read_history
    from jaxscan.measurement.drift import changes

    tests = read_history(args.history)
    found = changes(tests)
    written = []
    if args.png or args.report:
        from jaxscan.view.acceptance import draw_drift, drift_report, write_picture
        from jaxscan.view.report import write_report

        if args.png:
            write_picture(args.png, draw_drift(tests))
            written.append(str(args.png))
        if args.report:
            written += write_report(args.report, drift_report(tests, found))
    return {
        "kind": "drift",
        "path": str(args.history),
        "tests": [{name: test.get(name) for name in ("date", "artefact", "rig", "verdict")} for test in tests],
        "changes": [{**vars(each), "real": each.real} for each in found],
        "written": written,
    }


def _as_result(found: "Acceptance") -> dict[str, Any]:
    return {
        "kind": "acceptance",
        "artefact": found.artefact.name,
        "verdict": found.verdict,
        "places": found.places,
        "scans": list(found.scans),
        "figures": [{**vars(each), "unexplained": each.unexplained} for each in found.figures],
        "notes": list(found.notes),
        "failed": list(found.problems),
    }


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    lines = _changes_in_words(result) if result["kind"] == "drift" else _test_in_words(result)
    lines += [f"warning: {warning}." for warning in result.get("warnings", [])]
    if result["written"]:
        lines.append(f"written: {', '.join(result['written'])}")
    return "\n".join(lines)


def _test_in_words(result: dict[str, Any]) -> list[str]:
    from jaxscan.measurement.accept import expanded
    from jaxscan.measurement.verdict import worst_of

    count = len(result["scans"])
    said = f"{result['verdict']} {result['places']}".rstrip() if result["verdict"] else "no limits given"
    lines = [f"{result['artefact']}, {count} scan{'s' if count > 1 else ''}: {said}"]
    for figure in dict.fromkeys(row["figure"] for row in result["figures"]):
        rows = [row for row in result["figures"] if row["figure"] == figure]
        worst = max(rows, key=lambda row: abs(row["error"]))
        text = f"  {figure:12}  worst {worst['error']:+.4f} ± {worst['uncertainty']:.4f} mm ({worst['of']})"
        if worst["limit"] is not None:
            text += f", limit {worst['limit']:g}: {worst_of(row['verdict'] for row in rows)}"
        predicted = expanded(worst["sigma"], worst["sigma_rig"])
        if predicted is not None:
            text += f"; predicted within ± {predicted:.4f}"
        lines.append(text)
    lines += [f"note: {note}" for note in result["notes"]]
    return lines + [f"not tested: {problem}" for problem in result["failed"]]


def _changes_in_words(result: dict[str, Any]) -> list[str]:
    lines = [f"{result['path']}: {len(result['tests'])} test{'s' if len(result['tests']) > 1 else ''}"]
    for each in result["changes"]:
        known = "" if each["uncertainty"] is None else f" ± {each['uncertainty']:.4f}"
        text = f"  {each['artefact']}, {each['figure']} of {each['of']}: {each['change']:+.4f}{known} mm since "
        text += each["first"][:10] + (", by another rig" if each["recalibrated"] else "")
        lines.append(text + (": HAS CHANGED" if each["real"] else ""))
        if each["between"]:
            date, change = each["between"]
            lines.append(f"    in between, on {date[:10]}, it was {change:+.4f} mm off; now it is not")
    if any(each["real"] for each in result["changes"]):
        lines.append("the changes are larger than noise, places and rig explain: calibrate again, then test again")
    elif any(each["between"] for each in result["changes"]):
        lines.append(
            "figures that were off are right again: scans from that time are off by as much; find out what moved"
        )
    elif result["changes"]:
        lines.append("nothing has changed by more than its uncertainty")
    else:
        lines.append("a change needs two tests with the same artefact")
    return lines
