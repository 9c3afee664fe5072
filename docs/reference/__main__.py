"""The page of the public names, `python docs/reference`: docs/api.md, written from signatures and docstrings.

The page is read in a checkout as it stands. On the site `hook.py` puts mkdocstrings' entries in place of these, which
have the same text with links. Nothing is imported: griffe, which mkdocstrings uses too, reads the sources.
"""

import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import griffe
from hook import ENTRY

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "api.md"
_WIDTH = 100


def main() -> int:
    """Write the page again."""
    PAGE.write_text(written(PAGE.read_text(encoding="utf-8")), encoding="utf-8")
    return 0


def written(page: str) -> str:
    """The page with each entry as the sources have it now."""
    package = griffe.load("jaxscan", search_paths=[str(ROOT)], resolve_aliases=True, docstring_parser="google")
    return ENTRY.sub(lambda entry: f"<!-- {entry[1]} -->\n{_entry(package, entry[1])}\n<!-- / -->", page)


def _entry(package: Any, path: str) -> str:
    found = package[path.removeprefix("jaxscan.")]
    found = found.final_target if found.is_alias else found
    parts = [f"### {found.name}", _code(_signature(found)), *_docstring(found)]
    if found.is_class:
        members = "\n".join(_member(member) for member in _members(found))
        parts += ["*Members*", members] if members else []
    return "\n\n".join(parts)


def _members(of: Any) -> Iterator[Any]:
    """The public methods and properties that have a docstring."""
    for name, member in of.members.items():
        known = not name.startswith("_") and not member.is_alias and member.docstring is not None
        if known and (member.is_function or "property" in member.labels):
            yield member


def _member(member: Any) -> str:
    summary = " ".join(member.docstring.value.split("\n\n")[0].split())
    return f"- `{_flat(member) if member.is_function else member.name}`: {summary}"


def _signature(found: Any) -> str:
    flat = _flat(found)
    if len(flat) <= _WIDTH:
        return flat
    shown = ",\n".join(f"    {one}" for one in _parameters(found))
    return f"{found.name}(\n{shown},\n){_returns(found)}"


def _flat(found: Any) -> str:
    return f"{found.name}({', '.join(_parameters(found))}){_returns(found)}"


def _returns(found: Any) -> str:
    return "" if found.is_class or found.returns is None else f" -> {found.returns}"


def _parameters(found: Any) -> Iterator[str]:
    """The parameters as they are written; a keyword's star is one of them."""
    parameters = [one for one in found.parameters if one.name not in ("self", "cls")]
    starred = False
    for one in parameters:
        kind = one.kind.value if one.kind else ""
        star = {"variadic positional": "*", "variadic keyword": "**"}.get(kind, "")
        if kind == "keyword-only" and not starred:
            yield "*"
        starred = starred or kind in ("keyword-only", "variadic positional")
        annotation = "" if one.annotation is None else f": {one.annotation}"
        equals = " = " if annotation else "="
        default = "" if one.default is None or star else f"{equals}{one.default}"
        yield f"{star}{one.name}{annotation}{default}"


def _docstring(found: Any) -> Iterator[str]:
    """The docstring as Markdown: its text, then a list for each section."""
    if found.docstring is None:
        return
    for section in found.docstring.parsed:
        if section.kind.value == "text":
            yield section.value
            continue
        title = {"parameters": "Arguments", "raises": "Errors"}.get(section.kind.value, section.kind.value.title())
        items = []
        for one in section.value if isinstance(section.value, list) else []:
            name = str(one.annotation) if section.kind.value == "raises" else one.name
            items.append(f"- {f'`{name}`: ' if name else ''}{' '.join(one.description.split())}")
        yield f"*{title}*"
        yield "\n".join(items)


def _code(text: str) -> str:
    return f"```py\n{text}\n```"


if __name__ == "__main__":
    sys.exit(main())
