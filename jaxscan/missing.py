"""What is said of a file that is not there: which file was meant, or what is there."""

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Final

from jaxscan.errors import InputError

# Names that are listed, and how like the wanted one they are to be taken for it, 0 to 1.
_LISTED: Final = 6
_LIKE: Final = 0.6
# Of a folder no more than this number of entries is looked at.
_LOOKED_AT: Final = 2000


def no_such_file(path: Path, what: str = "file") -> InputError:
    """The error for a path that does not exist, or is a folder, with the names that are likely to be meant.

    Args:
        path: as it was given.
        what: that was looked for: "file", "file or folder".
    """
    if (path / "scan.toml").is_file():
        return InputError(
            f"{path}: has the photographs of a scan, and a file is needed: make its points first: jaxscan reconstruct "
            f"{path} --rig rig.json -o {path.name or 'scan'}.npz"
        )
    if path.is_dir():
        return InputError(f"{path}: is a folder, and a file is needed: name one: {_there(path)}")
    if path.is_symlink():
        return InputError(
            f"{path}: is a link to {path.readlink()}, which is not there: copy the {what}, or link it again"
        )
    folder = path.parent
    if not folder.is_dir():
        whole = next((each for each in folder.parents if each.is_dir()), Path())
        return InputError(f"{path}: there is no such {what}, nor its folder {folder}: {_there(whole)}: check the path")
    names = names_in(folder)
    meant = [name for name in names if Path(name).stem == path.name] or get_close_matches(
        path.name, names, _LISTED, _LIKE
    )
    if meant:
        return InputError(
            f"{path}: there is no such {what}: did you mean {listed([folder / name for name in meant], 'or')}?"
        )
    return InputError(f"{path}: there is no such {what}: {_there(folder)}: check the path")


def _there(folder: Path) -> str:
    """What a folder holds."""
    where = "this folder" if folder == Path() else str(folder)
    names = names_in(folder)
    return f"{where} has {listed(names, 'and')}" if names else f"{where} is empty"


def names_in(folder: Path) -> list[str]:
    """Names in a folder, folders with a slash behind, hidden ones left out."""
    try:
        found = [each for each, _ in zip(folder.iterdir(), range(_LOOKED_AT), strict=False)]
        return sorted(each.name + "/" * each.is_dir() for each in found if not each.name.startswith("."))
    except OSError:
        return []


def listed(names: Sequence[str | Path], joint: str) -> str:
    """Names with commas between them, the rest counted."""
    shown = [str(name) for name in names[:_LISTED]]
    if rest := len(names) - len(shown):
        return f"{', '.join(shown)} {joint} {rest} more"
    return f"{', '.join(shown[:-1])} {joint} {shown[-1]}" if len(shown) > 1 else "".join(shown)
