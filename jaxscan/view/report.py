"""A report of any kind: words, tables and figures once, written as one HTML file that needs nothing else, and as JSON.

Both writers take the same `Report`, so what the page says and what a program reads cannot differ. The page holds its
pictures, has no scripts and asks the network for nothing.
"""

import base64
import dataclasses
import json
import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from html import escape
from importlib.metadata import PackageNotFoundError, version
from io import BytesIO
from pathlib import Path
from typing import Any, Final, Literal

import numpy as np

from jaxscan.atomic import replacing
from jaxscan.files.digest import short_digest
from jaxscan.view.matplotlib_setup import pyplot

Level = Literal["good", "care", "stop"]

_DPI = 130
_STYLE: Final = """
:root { color-scheme: light dark; --ground: #fff; --ink: #1c1c1c; --soft: #444; --line: #ccc; --thin: #e4e4e4;
  --box: #f4f4f4; --good: #eef8f1; --care: #fff7e8; --stop: #fdeceb; --link: #1f5fbf; }
@media screen and (prefers-color-scheme: dark) {
  :root { --ground: #14181d; --ink: #e6eaf0; --soft: #a9b3c0; --line: #46505c; --thin: #2c343d;
    --box: #1f262e; --good: #14291c; --care: #33270f; --stop: #381a18; --link: #7fb0ff; }
}
body { margin: 0 auto; max-width: 54rem; padding: 1rem; color: var(--ink); background: var(--ground);
  font: 1rem/1.5 system-ui, "Segoe UI", Roboto, "Helvetica Neue", Arial, sans-serif; }
h1 { font-size: 1.6rem; line-height: 1.2; margin: 0.5rem 0 0.2rem; }
h2 { font-size: 1.25rem; margin: 2.2rem 0 0.5rem; border-bottom: 1px solid var(--line); padding-bottom: 0.2rem; }
p { margin: 0.5rem 0; }
.lead { font-size: 1.15rem; }
.box { border-left: 0.5rem solid #888; background: var(--box); padding: 0.5rem 1rem; margin: 0.7rem 0; }
.box strong { display: block; }
.good { border-color: #1e8449; background: var(--good); }
.care { border-color: #c77700; background: var(--care); }
.stop { border-color: #b3261e; background: var(--stop); }
a { color: var(--link); }
nav ul { columns: 16rem; margin: 0.3rem 0 0; }
figure { margin: 1.2rem 0; break-inside: avoid; }
figure img { width: 100%; height: auto; background: #fff; border-radius: 4px; }
figcaption { font-size: 0.92rem; color: var(--soft); }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-size: 0.9rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: 0.3rem 0; }
caption span { position: sticky; left: 0; display: inline-block; max-width: calc(100vw - 2rem); }
th, td { padding: 0.15rem 0.8rem 0.15rem 0; text-align: right; border-bottom: 1px solid var(--thin);
  white-space: nowrap; }
th { font-weight: 600; vertical-align: bottom; white-space: normal; }
th:first-child, td:first-child { text-align: left; }
ul { padding-left: 1.2rem; }
footer { margin-top: 3rem; font-size: 0.85rem; color: var(--soft); }
@media screen and (max-width: 40rem) { figure img { width: 40rem; } figcaption::before { content: "↔ "; } }
@media print { body { max-width: none; padding: 0; font-size: 10pt; } .scroll { overflow: visible; } }
"""


@dataclass(frozen=True)
class Figure:
    """A picture.

    Attributes:
        name: by which the JSON calls it.
        caption: what it shows, and what it would show if something were wrong.
        png: the picture.
    """

    name: str
    caption: str
    png: bytes


@dataclass(frozen=True)
class Table:
    """A table; a cell is a text, or a number that is shown to the digits that its column is given."""

    caption: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Box:
    """A statement that stands out.

    Attributes:
        level: good, to be taken care of, or a reason not to use the result.
        statement: what is the case.
        advice: what to do about it.
    """

    level: Level
    statement: str
    advice: str = ""


@dataclass(frozen=True)
class Section:
    """A part of a report, in the order in which it is read: statements, words, lists, tables, figures."""

    title: str
    boxes: tuple[Box, ...] = ()
    paragraphs: tuple[str, ...] = ()
    items: tuple[str, ...] = ()
    tables: tuple[Table, ...] = ()
    figures: tuple[Figure, ...] = ()


@dataclass(frozen=True)
class Report:
    """A report.

    Attributes:
        kind: of what; the JSON's format is "jaxscan-" and this.
        title: of the page.
        verdict: the one sentence that a reader takes away.
        sections: the rest.
        numbers: what figures and tables were made from: dataclasses, arrays, plain values.
    """

    kind: str
    title: str
    verdict: Box
    sections: tuple[Section, ...]
    numbers: dict[str, Any] = field(default_factory=dict)

    def recorded(self, files: Mapping[str, Sequence[Path]]) -> "Report":
        """The same with a last section: when it was made, by which version, and from which files.

        Args:
            files: by what they are, as "rig"; each with the first digits of its SHA-256, which tell it from another.
        """
        try:
            which = version("jaxscan")
        except PackageNotFoundError:
            which = "of a folder that is not installed"
        said = [f"made {datetime.now(UTC).isoformat(timespec='seconds')}, jaxscan {which}"]
        said += [f"{what}: {path}, SHA-256 {short_digest(path)}…" for what, paths in files.items() for path in paths]
        return dataclasses.replace(self, sections=(*self.sections, Section("Record", items=tuple(said))))


def write_report_html(path: str | os.PathLike[str], report: Report) -> None:
    """One page, whole or not at all.

    Raises:
        InputError: the file cannot be written.
    """
    with replacing(path, "w") as file:
        file.write(as_html(report))


def write_report_json(path: str | os.PathLike[str], report: Report) -> None:
    """The same words and tables, with the numbers in place of the pictures.

    Raises:
        InputError: the file cannot be written.
    """
    with replacing(path, "w") as file:
        json.dump(as_dict(report), file, ensure_ascii=False, allow_nan=False, indent=1)


def write_report(folder: Path, report: Report) -> list[str]:
    """`report.html` and `report.json` in a folder; their paths.

    Raises:
        InputError: a file cannot be written.
    """
    html, numbers = folder / "report.html", folder / "report.json"
    write_report_html(html, report)
    write_report_json(numbers, report)
    return [str(html), str(numbers)]


def as_dict(report: Report) -> dict[str, Any]:
    """What the JSON holds: the report without its pictures; NaN is null."""
    return {
        "format": f"jaxscan-{report.kind}/1",
        "title": report.title,
        "verdict": plain(report.verdict),
        "sections": [plain(section) for section in report.sections],
        "numbers": plain(report.numbers),
    }


def plain(value: Any) -> Any:
    """Dataclasses, arrays and NumPy's numbers as what JSON knows; bytes are left out, NaN is None."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = ((f.name, getattr(value, f.name)) for f in dataclasses.fields(value))
        return {name: plain(each) for name, each in fields if not isinstance(each, bytes)}
    if isinstance(value, dict):
        return {str(key): plain(each) for key, each in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [plain(each) for each in (value.tolist() if isinstance(value, np.ndarray) else value)]
    if isinstance(value, np.generic):
        return plain(value.item())
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value


def draw(name: str, caption: str, figure: Any) -> Figure:
    """A matplotlib figure as part of a report; it is closed."""
    plt = pyplot()
    out = BytesIO()
    figure.savefig(out, format="png", dpi=_DPI, metadata={"Software": None})
    plt.close(figure)
    return Figure(name, caption, out.getvalue())


def as_html(report: Report) -> str:
    """The page."""
    parts = [
        "<!DOCTYPE html>",
        '<html lang="en">',
        "<head>",
        '<meta charset="utf-8"/>',
        '<meta name="viewport" content="width=device-width, initial-scale=1"/>',
        f"<title>{escape(report.title)}</title>",
        f"<style>{_STYLE}</style>",
        "</head>",
        "<body>",
        f"<h1>{escape(report.title)}</h1>",
        _box(report.verdict, "lead "),
    ]
    if len(report.sections) > 1:
        links = (f'<li><a href="#part-{i}">{escape(s.title)}</a></li>' for i, s in enumerate(report.sections, 1))
        parts += ['<nav aria-label="Contents"><ul>', *links, "</ul></nav>"]
    for i, section in enumerate(report.sections, 1):
        parts += [f'<section id="part-{i}">', f"<h2>{escape(section.title)}</h2>"]
        parts += [_box(box) for box in section.boxes]
        parts += [f"<p>{escape(text)}</p>" for text in section.paragraphs]
        if section.items:
            parts += ["<ul>", *(f"<li>{escape(text)}</li>" for text in section.items), "</ul>"]
        parts += [_table(table) for table in section.tables]
        parts += [_figure(figure) for figure in section.figures]
        parts.append("</section>")
    parts += ["<footer>Written by jaxscan. The same as numbers: the JSON file beside this page.</footer>"]
    return "\n".join([*parts, "</body>", "</html>", ""])


def _box(box: Box, style: str = "") -> str:
    advice = f"<span>{escape(box.advice)}</span>" if box.advice else ""
    return f'<div class="{style}box {box.level}"><strong>{escape(box.statement)}</strong>{advice}</div>'


def _table(table: Table) -> str:
    def row(cells: Sequence[str], tag: str) -> str:
        return f"<tr>{''.join(f'<{tag}>{escape(cell)}</{tag}>' for cell in cells)}</tr>"

    body = "\n".join(row(cells, "td") for cells in table.rows)
    return (
        f'<div class="scroll"><table>\n<caption><span>{escape(table.caption)}</span></caption>\n'
        f"<thead>{row(table.columns, 'th')}</thead>\n<tbody>\n{body}\n</tbody>\n</table></div>"
    )


def _figure(figure: Figure) -> str:
    data = base64.b64encode(figure.png).decode()
    caption = escape(figure.caption)
    return (
        f'<figure id="{escape(figure.name)}">\n<div class="scroll"><img alt="{caption}" '
        f'src="data:image/png;base64,{data}"/></div>\n'
        f"<figcaption>{caption}</figcaption>\n</figure>"
    )
