"""Public names that were renamed are found for one version, with a warning."""

import pytest

import jaxscan


@pytest.mark.parametrize(
    ("old", "new"),
    [("Kept", "InlierMask"), ("arrange", "coarse_register"), ("next_photographs", "next_best_views")],
)
def test_an_old_name_is_found_with_a_warning(old, new):
    with pytest.warns(DeprecationWarning, match=f"jaxscan.{old} is now jaxscan.{new}"):
        found = getattr(jaxscan, old)
    assert found is getattr(jaxscan, new)
    assert old not in dir(jaxscan)
