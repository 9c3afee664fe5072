"""The scans of a batch measured, each once: what was found is kept in the record of its result."""

import hashlib
import tomllib
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jaxscan.cli.batch_log import Log, notes_in_words
from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.files.part_file import Part


def measured_scans(out: Path, rig: Path, part: "Part", log: Log) -> dict[str, Any]:
    """Every scan that is there, as `jaxscan measure` has it; the table and the charts are written.

    What cannot be measured is a failure of its scan, in the log.

    Args:
        out: the folder of the results.
        rig: of all of them.
        part: what is measured.
        log: of the batch.
    """
    from jaxscan.cli.progress import progress, say, step
    from jaxscan.files.measured_csv import write_scans_csv

    by = _digest_of(part)
    found: dict[str, dict[str, Any]] = {}
    with progress("measuring scans", len(log.records), "scan") as advance:
        for task in log.tree.tasks:
            record = log.records.get(task.name)
            if record is None:
                continue
            known = record.measured
            if known is None or known["part"] != by:
                try:
                    known = {"part": by, **_measured(task.output, rig, part)}
                    replace(record, measured=known).write(task.output)
                except InputError as error:
                    log.failed[task.name] = f"not measured: {error}"
                    say(f"jaxscan: {error}")
                    known = None
            if known is not None:
                found[task.name] = known
                if known["failed"]:
                    log.failed[task.name] = f"not measured: {'; '.join(known['failed'])}"
            advance(1)
    log.write()
    rows = {scan: known["dimensions"] for scan, known in found.items()}
    written = [str(out / "measured.csv")]
    write_scans_csv(out / "measured.csv", rows, log.failed)
    if find_spec("matplotlib") is not None and part.dimensions and rows:
        from jaxscan.view.measured_part import control_charts

        step("drawing control charts")
        control_charts(out / "measured.png", rows)
        written.append(str(out / "measured.png"))
    dimensions = [
        {"scan": scan, **{name: known[name] for name in ("verdict", "dimensions", "notes")}}
        for scan, known in found.items()
    ]
    return {"measured": dimensions, "written": written}


def measured_in_words(result: dict[str, Any]) -> list[str]:
    """What was measured: of each scan a line, and where the table and the charts are."""
    if "measured" not in result:
        return []
    from jaxscan.measurement.rows import value_in_words

    lines = []
    for each in result["measured"]:
        cells = "; ".join(f"{row['name']} {value_in_words(row)}" for row in each["dimensions"])
        lines.append(f"  {each['scan']}: {cells}")
    verdicts = Counter(each["verdict"] for each in result["measured"] if each["verdict"])
    counts = ", ".join(f"{count} {verdict}" for verdict, count in verdicts.most_common())
    return [
        *([f"of {len(lines)} measured scans {counts}:"] if counts else []),
        *lines,
        *notes_in_words(result["measured"]),
        f"written: {', '.join(result['written'])}",
    ]


def _measured(result: Path, rig: Path, part: "Part") -> dict[str, Any]:
    from jaxscan.cli.measure import read_surface
    from jaxscan.measurement.measure import measure
    from jaxscan.measurement.rows import rows_of

    scanned = read_surface(result, rig)[0]
    if scanned.image is not None:
        # The batch says itself what was noted of each scan.
        scanned = replace(scanned, image=replace(scanned.image, notes=()))
    found = measure(scanned, part)
    notes = {"notes": list(found.notes), "failed": list(found.problems)}
    return {"verdict": found.verdict, "dimensions": rows_of(found), **notes}


def _digest_of(part: "Part") -> str:
    """What tells a part from another: its file, and the meshes that are named in it."""
    content = part.path.read_bytes()
    digest = hashlib.sha256(content)
    for text in _texts(tomllib.loads(content.decode())):
        named = part.path.parent / text
        if named.is_file():
            digest.update(named.read_bytes())
    return digest.hexdigest()


def _texts(value: Any) -> Iterator[str]:
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _texts(inner)
