"""The words of pages and messages: they are counted right, and what is wrong with them is found."""

import importlib.util
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[1]


def load(name: str, path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


readability = load("readability", ROOT / "docs" / "words" / "readability.py")
words = load("words_of_jaxscan", ROOT / "docs" / "words" / "__main__.py")

# By the Carnegie Mellon pronouncing dictionary; over all pages 98 % of the words are counted as there.
SYLLABLES = {
    1: "the one made makes walked scale use used named times size whole file files stage known",
    2: "table boxes painted station special laser measure pixel needed edges changes people axis image trying",
    3: "manual camera checkerboard photograph photographs visible radius precision reconstruct surfaces",
    4: "calibration geometry material",
    5: "triangulation",
}


@pytest.mark.parametrize(("count", "word"), [(n, word) for n, line in SYLLABLES.items() for word in line.split()])
def test_syllables(count: int, word: str) -> None:
    assert readability.syllables_of(word) == count


def test_the_formula_on_a_text_that_is_counted_by_hand() -> None:
    # 13 words, 2 sentences, 17 syllables.
    counted = readability.reading("The stage moves one step. Then the camera takes a photograph of it.\n")
    assert counted == (13, 2, 17)
    assert counted.ease == pytest.approx(206.835 - 1.015 * 13 / 2 - 84.6 * 17 / 13)


def test_what_is_no_prose_is_left_out() -> None:
    page = """# A heading of words

Run `jaxscan calibrate` on 3.5 mm. See [the page](a/b.md).

    σ = z / f and more words

| a | table of words |
|---|---|

```
jaxscan inspect
```

- one item
- another item
"""
    assert readability.prose(page) == ["Run on 3 5 mm.", "See the page.", "one item", "another item"]


def test_hard_words_and_long_sentences_are_hard_to_read() -> None:
    easy = "You press the key. The stage moves. You take a photograph."
    hard = "Notwithstanding considerable methodological heterogeneity, interdisciplinary characterisations proliferate."
    long = "You press the key and the stage moves and you take a photograph and " * 4 + "then it ends."
    assert readability.reading(hard).ease < 0 < readability.reading(long).ease < readability.reading(easy).ease


def test_the_pages_and_messages_pass(capsys: pytest.CaptureFixture[str]) -> None:
    faults = [*words.pages(), *words.phrases()]
    assert faults == []
    assert capsys.readouterr().out.count("\n") == 1 + len(words.all_pages())


def test_banned_phrases_are_found_in_messages_and_not_in_names() -> None:
    source = '''"""It takes so many of them."""
so_many = 1
raise ValueError(f"{so_many}: give so many steps, as {so_many} hangs on it")
'''
    ((line, text),) = words.messages(source)
    assert line == 3
    assert [fault.partition(":")[0] for fault in words._found(text)] == ['"so many"', '"hangs on"']


def test_banned_phrases_are_found_in_docstrings_and_comments_over_ends_of_lines() -> None:
    source = '''"""It takes so
many of them."""

x = 1  # so many # of them
# It hangs
# on this.

# It hangs
'''
    assert list(words.docstrings(source)) == [(1, "It takes so many of them.")]
    found = list(words.comments(source))
    assert found == [(4, "so many # of them It hangs on this."), (8, "It hangs")]
    assert [len(list(words._found(text))) for _, text in found] == [2, 0]


def test_a_source_with_a_banned_phrase_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "jaxscan").mkdir()
    (tmp_path / "docs").mkdir()
    (tmp_path / "README.md").write_text("Plain.\n")
    (tmp_path / "jaxscan" / "a.py").write_text('x = 1\n# It hangs\n# on this.\ny = "It is " "amiss"\n')
    monkeypatch.setattr(words, "ROOT", tmp_path)
    assert [fault.rpartition(":")[0] for fault in words.phrases()] == [
        'jaxscan/a.py:4: "amiss"',
        'jaxscan/a.py:2: "hangs on"',
    ]


def test_the_readme_is_short() -> None:
    assert len((ROOT / "README.md").read_text(encoding="utf-8").splitlines()) <= 120
