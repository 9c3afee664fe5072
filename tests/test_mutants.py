"""The list of mutants keeps up with the code; `python -m tests.mutants` tries them."""

import ast

import pytest

from tests.mutants import MUTANTS, ROOT, mutated


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.what)
def test_what_is_changed_stands_there_once(mutant):
    text = (ROOT / mutant.file).read_text(encoding="utf-8")
    ast.parse(mutated(mutant, text))
    assert mutated(mutant, text) != text
    assert all((ROOT / test).is_file() for test in mutant.tests.split())
