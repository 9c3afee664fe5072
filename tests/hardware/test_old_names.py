"""Names that were renamed are found for one version, with a warning."""

import importlib

import pytest

import hardware


@pytest.mark.parametrize("module", ["hardware", "hardware.protocols"])
@pytest.mark.parametrize("name", ["Camera", "Stage", "Laser"])
def test_old_names_of_the_protocols_warn(module, name):
    with pytest.warns(DeprecationWarning, match=rf"{module}\.{name} is now {module}\.{name}Driver") as told:
        found = getattr(importlib.import_module(module), name)
    assert found is getattr(hardware, f"{name}Driver")
    assert told[0].filename == __file__


def test_what_never_was_is_not_there():
    with pytest.raises(AttributeError, match="module 'hardware' has no attribute 'Motor'"):
        hardware.Motor  # noqa: B018
