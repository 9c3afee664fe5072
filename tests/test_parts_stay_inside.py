"""What a lens, a light plane, a stage and a turntable are made of is known to rig, files and simulation alone."""

import ast
import re
from pathlib import Path

ROOT = Path(__file__).parents[1]
INSIDE = ("rig", "files", "simulation")
NUMBERS = {"omega", "per_step"}
# OpenCV's lens terms, and who has their inverse for the kernel.
TERMS = {"radial", "tangential"}
FAST_INVERSE = "jaxscan/reconstruction/opencv_inverse.py"
PARTS = {"light", "lights", "motion", "axis", "sheet", "sheets", "link", "part", "lens"}
KINDS = {"Light", "Lens", "Motion", "AxisMotion", "LightPlane", "Linear", "Rotary", "Chain", "Fixed"}
# Called as a part, and none: the light of a photograph, the move that a comparison finds, the name of an axis, a lens
# or a kind of sheet that was asked for, the part that a batch measures.
OTHERS = {
    "image.light",
    "self.light",
    "stripe.light",
    "found.motion",
    "work.axis",
    "self._axis",
    "args.axis",
    "args.lens",
    "args.sheet",
    "jaxscan/cli/batch.py: part",
    "jaxscan/cli/summary.py: light",
    "jaxscan/measurement/scanned.py: part",
    "jaxscan/surface/compare.py: motion",
}


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


def test_no_module_outside_reads_where_an_axis_is():
    """Other things have a centre: of a part it would be read by way of its axis."""
    found = [
        f"{path}:{node.lineno}"
        for path, tree in outside()
        for node in ast.walk(tree)
        if isinstance(node, ast.Attribute)
        and node.attr in ("centre", "plane", "stage", "turntable")
        and PARTS & set(re.findall(r"\w+", ast.unparse(node.value)))
        | {"rig"} & set(re.findall(r"\w+", ast.unparse(node.value)))
    ]
    print(f"modules outside that read a part's place: {len(found)}")
    assert found == []


def is_none(node):
    return isinstance(node, ast.Constant) and node.value is None


def test_no_module_outside_asks_whether_there_is_a_part():
    found = []
    for path, tree in outside():
        for node in ast.walk(tree):
            if not isinstance(node, ast.Compare) or not any(map(is_none, (node.left, *node.comparators))):
                continue
            for part in (node.left, *node.comparators):
                last = part.attr if isinstance(part, ast.Attribute) else getattr(part, "id", "")
                asked = ast.unparse(part)
                if last.strip("_") in PARTS and not {asked, f"{path.as_posix()}: {asked}"} & OTHERS:
                    found.append(f"{path}:{node.lineno}: {asked}")
    print(f"tests of a part for None: {len(found)}")
    assert found == []


def test_no_module_outside_lets_a_part_be_none():
    found = []
    for path, tree in outside():
        for node in ast.walk(tree):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.BitOr) and is_none(node.right):
                kinds = {x.id for x in ast.walk(node.left) if isinstance(x, ast.Name)} & KINDS
                if kinds and not isinstance(node.left, ast.Subscript):
                    found.append(f"{path}:{node.lineno}: {ast.unparse(node)}")
    print(f"parts that may be None: {len(found)}")
    assert found == []
