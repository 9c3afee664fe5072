"""What a file is that was given instead of another, in words, for errors."""

from contextlib import suppress
from pathlib import Path
from typing import Final

from jaxscan.errors import InputError

_BY_ENDING: Final = {
    ".toml": "a TOML file",
    ".json": "a JSON file",
    ".npz": "a range image or other arrays of NumPy",
    ".mat": "a file of MATLAB",
    ".ply": "a cloud or a mesh",
    ".stl": "a mesh",
    ".obj": "a mesh",
    ".glb": "a mesh",
    ".pdf": "a PDF",
    ".zip": "an archive",
}


def kind_in_words(path: Path) -> str:
    """What a file is: a photograph by its content, others by their ending; "" where neither shows it."""
    from jaxscan.files.scan import VIDEO_ENDINGS
    from jaxscan.images import image_size

    with suppress(InputError):
        image_size(path)
        return "a photograph"
    ending = path.suffix.lower()
    return "a video" if ending in VIDEO_ENDINGS else _BY_ENDING.get(ending, "")
