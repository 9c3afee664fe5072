"""mkdocs: mkdocstrings' entries in place of those that `python docs/reference` wrote."""

import re
from typing import Any

# An entry: its name, and what was written for it.
ENTRY = re.compile(r"^<!-- (jaxscan[\w.]*) -->$.*?^<!-- / -->$", re.M | re.S)


def on_page_markdown(markdown: str, page: Any, **_: Any) -> str:
    """The page of the public names as mkdocstrings takes it."""
    return ENTRY.sub(r"::: \1", markdown) if page.file.src_uri == "api.md" else markdown
