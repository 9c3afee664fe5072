"""What a lens, a light plane, a stage and a turntable are made of is known to rig, files and simulation alone."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
INSIDE = ("rig", "files", "simulation")
NUMBERS = {"omega", "per_step"}
# OpenCV's lens terms, and who has their inverse for the kernel.
TERMS = {"radial", "tangential"}
FAST_INVERSE = "jaxscan/reconstruction/opencv_inverse.py"
PARTS = {"light", "lights", "motion", "axis", "sheet"}


def outside():
    """The modules that know of a rig by its protocols alone, with their trees."""
    for folder in (ROOT / "jaxscan", ROOT / "hardware"):
        for path in sorted(folder.rglob("*.py")):
            if path.relative_to(folder).parts[0] not in INSIDE:
                yield path.relative_to(ROOT), ast.parse(path.read_text())


def names(tree):
    for node in ast.walk(tree):
        if isinstance(node, ast.Name):
            yield node.id
        elif isinstance(node, ast.Attribute):
            yield node.attr
        elif isinstance(node, ast.arg | ast.keyword):
            yield node.arg
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield from node.value.split(".") if " " not in node.value else ()


def test_no_module_outside_names_the_numbers_of_a_part():
    found = {str(path) for path, tree in outside() if NUMBERS & set(names(tree))}
    print(f"modules outside of {', '.join(INSIDE)} that name {', '.join(sorted(NUMBERS))}: {len(found)}")
    assert found == set()


def test_one_module_outside_names_the_terms_of_opencvs_lenses():
    found = {str(path) for path, tree in outside() if TERMS & set(names(tree))}
    print(f"modules outside of {', '.join(INSIDE)} that name {', '.join(sorted(TERMS))}: {', '.join(sorted(found))}")
    assert found == {FAST_INVERSE}


def test_no_module_outside_asks_whether_the_rig_has_a_part():
    found = []
    for path, tree in outside():
        for node in ast.walk(tree):
            if isinstance(node, ast.Compare) and any(
                isinstance(x, ast.Constant) and x.value is None for x in node.comparators
            ):
                part = node.left
                if isinstance(part, ast.Attribute) and part.attr in PARTS and "rig" in ast.unparse(part.value):
                    found.append(f"{path}:{node.lineno}")
    print(f"tests of a part of the rig for None: {len(found)}")
    assert found == []
