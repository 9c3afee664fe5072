"""Puts every decision into the site's navigation, in the order of their numbers."""

from pathlib import Path
from typing import Any


def on_config(config: Any) -> Any:
    """Fill in the empty list of `mkdocs.yml`."""
    (decisions,) = (
        page for section in config.nav for pages in section.values() for page in pages if "Decisions" in page
    )
    pages = sorted(Path(config.docs_dir, "decisions").glob("[0-9]*.md"))
    decisions["Decisions"] = [f"decisions/{page.name}" for page in pages]
    return config
