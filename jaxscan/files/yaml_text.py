"""YAML as other programs write it: numbers as YAML 1.2 has them, OpenCV's matrices, no key twice, no references.

PyYAML reads YAML 1.1, where `1e-05`, as C++ programs write it, is a text. References (`&`, `*`) are refused: a few
lines of them unfold to gigabytes.
"""

import re
from pathlib import Path
from typing import Any, Final

import yaml

from jaxscan.errors import InputError
from jaxscan.files.table import Table, show
from jaxscan.files.text import parse_file

_FLOAT: Final = re.compile(r"[-+]?(\.[0-9]+|[0-9]+(\.[0-9]*)?)([eE][-+]?[0-9]+)?$")


class _Loader(yaml.SafeLoader):
    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("it refers back to a part of itself (*): write the values out")
        return super().compose_node(parent, index)

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        values = super().construct_mapping(node, deep)
        if len(values) != len(node.value):
            raise yaml.YAMLError(f"a key stands twice in what begins at line {node.start_mark.line + 1}")
        return values


def _opencv(loader: _Loader, kind: str, node: yaml.Node) -> Any:
    if not isinstance(node, yaml.MappingNode):
        raise yaml.YAMLError(f"!!opencv-{kind} in line {node.start_mark.line + 1} must have rows, cols and data")
    return loader.construct_mapping(node, deep=True)


_Loader.add_multi_constructor("tag:yaml.org,2002:opencv-", _opencv)
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", _FLOAT, list("-+.0123456789"))


def read_yaml(path: Path) -> Table:
    """The outermost table of a YAML file of one document.

    Raises:
        InputError: the file is missing, not text, not YAML, or not a table; the text says where.
    """

    def parse(text: str) -> Any:
        try:
            # OpenCV's own first line, %YAML:1.0, is none of YAML's.
            plain = re.sub(r"\A%YAML[^\n]*", "", text)
            documents = [document for document in yaml.load_all(plain, _Loader) if document is not None]
        except yaml.YAMLError as error:
            raise ValueError(str(error)) from error
        if len(documents) > 1:
            raise InputError(f"{path}: holds {len(documents)} documents, divided by ---: keep one of them")
        return documents[0] if documents else None

    values = parse_file(path, "YAML", parse)
    if not isinstance(values, dict):
        raise InputError(f"{path}: holds {show(values)}, but keys with values are expected: check which file it is")
    return Table(path, "", {str(key): value for key, value in values.items()})


def dump_yaml(values: dict[str, Any]) -> str:
    """YAML with lists of numbers on one line, every number with all its digits."""
    return yaml.safe_dump(values, sort_keys=False, default_flow_style=None, width=100)
