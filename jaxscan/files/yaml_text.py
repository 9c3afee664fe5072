"""YAML as other programs write it: plain values, OpenCV's matrices, no key twice, no references, no other tags.

PyYAML takes the text apart; what it stands for is made here. Its own makers read YAML 1.1, where `1e-05`, as C++
programs write it, is a text, and `!!int ''` an error of another kind each time. References (`&`, `*`) are refused: a
few lines of them unfold to gigabytes.
"""

import re
from pathlib import Path
from typing import Any, Final

import yaml

from jaxscan.errors import InputError
from jaxscan.files.table import Table, show
from jaxscan.files.text import parse_file

# libyaml is fifteen times faster than Python; a wheel of PyYAML has it.
_PARSER: Final = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_DEEPEST: Final = 100
_TAG: Final = "tag:yaml.org,2002:"
# These say what is seen without them.
_PLAIN_TAGS: Final = (None, f"{_TAG}str", f"{_TAG}map", f"{_TAG}seq")
_OPENCV: Final = f"{_TAG}opencv-"
_FLOAT: Final = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?")
_WHOLE: Final = re.compile(r"[-+]?[0-9]+")
_NOT_FINITE: Final = re.compile(r"([-+]?)\.(inf|nan)", re.IGNORECASE)
_WORDS: Final[dict[str, bool | None]] = {
    **dict.fromkeys(("", "~", "null"), None),
    **dict.fromkeys(("true", "yes", "on"), True),
    **dict.fromkeys(("false", "no", "off"), False),
}


def read_yaml(path: Path) -> Table:
    """The outermost table of a YAML file of one document.

    Raises:
        InputError: the file is missing, not text, not YAML, or not a table; the text says where.
    """

    def parse(text: str) -> Any:
        try:
            # OpenCV's own first line, %YAML:1.0, is none of YAML's.
            documents = _documents(re.sub(r"\A%YAML[^\n]*", "", text))
        except yaml.YAMLError as error:
            # From PyYAML 6.0.4 on the parser has a limit of its own, and looks ahead.
            if "maximum nesting depth" in str(error):
                raise RecursionError from error
            raise ValueError(str(error)) from error
        if len(documents) > 1:
            raise InputError(f"{path}: holds {len(documents)} documents, divided by ---: keep one of them")
        return documents[0] if documents else None

    values = parse_file(path, "YAML", parse)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds {show(values)}, but keys with values are expected: check which file it is")
    return Table(path, "", values)


def _documents(text: str) -> list[Any]:
    """What stands in each document that holds anything."""
    documents: list[Any] = []
    # The tables and lists that are not closed yet, the innermost last; of a table the key whose value comes next.
    open_ones: list[dict[str, Any] | list[Any]] = [documents]
    keys: list[str | None] = [None]
    for event in yaml.parse(text, _PARSER):
        if isinstance(event, yaml.CollectionEndEvent):
            open_ones.pop()
            keys.pop()
        if not isinstance(event, yaml.NodeEvent):
            continue
        value, holder = _value(event), open_ones[-1]
        if isinstance(holder, list):
            holder.append(value)
        elif (key := keys[-1]) is None:
            keys[-1] = _key(event, holder)
            continue
        else:
            holder[key], keys[-1] = value, None
        if isinstance(value, dict | list):
            open_ones.append(value)
            keys.append(None)
            if len(open_ones) > _DEEPEST:
                raise yaml.YAMLError(f"{_line(event)} is nested too deeply")
    return [document for document in documents if document is not None]


def _value(event: yaml.NodeEvent) -> Any:
    """An empty table or list, or a plain value."""
    if isinstance(event, yaml.AliasEvent):
        raise yaml.YAMLError(f"{_line(event)} refers back to a part of the file (*): write the values out")
    tag: str | None = getattr(event, "tag", None)
    if isinstance(event, yaml.MappingStartEvent) and tag is not None and tag.startswith(_OPENCV):
        return {}
    if tag is not None and tag.startswith(_OPENCV):
        raise yaml.YAMLError(f"!!{tag.removeprefix(_TAG)} in {_line(event)} must have rows, cols and data")
    if tag not in _PLAIN_TAGS:
        raise yaml.YAMLError(f"{_line(event)} has the tag {tag}, which is not read here: write the value without it")
    if isinstance(event, yaml.MappingStartEvent):
        return {}
    if isinstance(event, yaml.SequenceStartEvent):
        return []
    if not isinstance(event, yaml.ScalarEvent):
        raise yaml.YAMLError(f"{_line(event)} has neither a table, nor a list, nor a value")
    return _plain(event.value) if event.implicit[0] else event.value


def _key(event: yaml.NodeEvent, holder: dict[str, Any]) -> str:
    if not isinstance(event, yaml.ScalarEvent):
        raise yaml.YAMLError(f"{_line(event)} has a table or a list for a key: write a word")
    if event.value in holder:
        raise yaml.YAMLError(f"the key {event.value} appears twice in one table, again in {_line(event)}")
    return event.value


def _plain(text: str) -> Any:
    """A value without quotes, as YAML 1.2 has numbers, and 1.1 has yes and no."""
    if _WHOLE.fullmatch(text):
        return int(text)
    if _FLOAT.fullmatch(text):
        return float(text)
    if found := _NOT_FINITE.fullmatch(text):
        return float(found[1] + found[2])
    return _WORDS.get(text.lower(), text)


def _line(event: yaml.Event) -> str:
    return f"line {event.start_mark.line + 1}"


def dump_yaml(values: dict[str, Any]) -> str:
    """YAML with lists of numbers on one line, every number with all its digits."""
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=100)
