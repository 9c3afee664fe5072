"""The words of this project: `python docs/words`.

Checks that each page is easy enough to read (R. Flesch's reading ease: guides 50, reference pages 40), that its
sentences are not too long, that pages, and the messages, docstrings and comments of the code, have none of the phrases
that read as translated, and the spelling, by codespell where it is installed (extra `dev`). Prints a figure for each
page; ends with status 1 where something is wrong.
"""

import ast
import io
import re
import subprocess
import sys
import tokenize
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from readability import reading

ROOT = Path(__file__).resolve().parents[2]
GUIDE, REFERENCE = 50.0, 40.0
# Words for each sentence, on average.
LONGEST = 26.0
REFERENCES = ("api.md", "benchmarks.md", "security.md", "limitations.md")
# Phrase, and what to write instead.
BANNED = {
    r"\bso many\b": "the number, `n`, or the parameter's name",
    r"\bthe mend\b|\bmended\b|\bto mend\b": "fix",
    r"\btold with\b": "set with, chosen with",
    r"\btold of\b": "registered, reported",
    r"\bhangs? on\b": "depends on",
    r"\bhangs? together\b": "are connected",
    r"\bforetold\b": "predicted",
    r"\bamiss\b": "wrong",
    r"\bspeaks? for\b": "supports",
    r"\bof theirs\b": "their",
    r"\bgone on with\b": "continued",
    r"\bgoe?s? on with\b": "continues",
    r"\blets? alone\b": "leaves unchanged",
    r"\bin the place of\b": "instead of",
    r"\bto be believed\b|\bbelieves? (?:it|them)\b": "trusted",
    r"\blaid in\b": "initial",
    r"\bthe way round\b": "the loop",
    r"\bas good as none\b": "no use",
    r"\banew\b": "again",
    r"\bstands? to each other\b": "pose",
}
_BANNED = [(re.compile(pattern, re.IGNORECASE), better) for pattern, better in BANNED.items()]
_ANY = re.compile("|".join(BANNED), re.IGNORECASE)
# Folders of the sources that are checked.
_SOURCES = ("jaxscan", "hardware", "benchmarks", "examples")
# What separates the words of a sentence in a source: ends of lines, quotes of adjacent strings, signs of comments.
_BREAK = re.compile(r"""["']\s*[rbf]*["']|[\s#]+""")
# What codespell takes for misspelt.
SPELT = (
    "ba,nd,te,ue,hist,mater,fo,ser,indx,re-use,arange,ro,ot,ans,coo,couldn,som,fro,shepperd,uint,dof,thead,ws,sinc,upto"
)


def main() -> int:
    """Check, print and return the exit status."""
    faults = [*pages(), *phrases(), *spelling()]
    for fault in faults:
        print(fault, file=sys.stderr)
    return 1 if faults else 0


def all_pages() -> list[Path]:
    """README and docs, without the decisions, which are for those who change the code."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]


def pages() -> Iterator[str]:
    """Print how easy each page is to read; what is not easy enough."""
    print("page                     reading ease   words/sentence   words")
    for page in all_pages():
        counted = reading(page.read_text(encoding="utf-8"))
        length = counted.words / max(counted.sentences, 1)
        least = REFERENCE if page.name in REFERENCES else GUIDE
        print(f"{page.name:24} {counted.ease:12.1f} {length:16.1f} {counted.words:7}")
        if counted.ease < least:
            yield f"{page.name}: reading ease {counted.ease:.1f}, below {least:g}: shorter sentences, shorter words"
        if length > LONGEST:
            yield f"{page.name}: {length:.1f} words in a sentence on average, above {LONGEST:g}: shorter sentences"


def phrases() -> Iterator[str]:
    """Banned phrases in pages, and in the messages, docstrings and comments of the code."""
    for page in all_pages():
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), start=1):
            yield from (f"{page.name}:{number}: {fault}" for fault in _found(line))
    for path in (path for folder in _SOURCES for path in sorted((ROOT / folder).rglob("*.py"))):
        source, name = path.read_text(encoding="utf-8"), path.relative_to(ROOT).as_posix()
        # Most sources have none, and need not be parsed.
        if _ANY.search(_BREAK.sub(" ", source)):
            prose = (*docstrings(source), *comments(source))
            for number, text in (*messages(source), *prose):
                yield from (f"{name}:{number}: {fault}" for fault in _found(text))
        if '"""It does."""' in source:
            yield f'{name}: the docstring "It does." says nothing: write what is returned'


def comments(source: str) -> Iterator[tuple[int, str]]:
    """The comments of a module, with their first lines; lines that follow one another are one comment."""
    text, first, last = "", 0, 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        line = token.start[0]
        if text and line != last + 1:
            yield first, text
            text = ""
        first = first if text else line
        text, last = f"{text} {token.string.lstrip('#').strip()}".lstrip(), line
    if text:
        yield first, text


def docstrings(source: str) -> Iterator[tuple[int, str]]:
    """The docstrings of a module, its classes and functions, with their lines; breaks of lines are spaces."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            yield node.lineno, " ".join(node.value.value.split())


def messages(source: str) -> Iterator[tuple[int, str]]:
    """The texts of a module that are no docstrings, with their lines; of an f-string the whole."""
    tree = ast.parse(source)
    inside = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in ast.walk(node)}
    alone = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else "…" for part in node.values]
            yield node.lineno, "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in inside | alone:
            yield node.lineno, node.value


def _found(text: str) -> Iterator[str]:
    for pattern, better in _BANNED if _ANY.search(text) else ():
        if found := pattern.search(text):
            yield f'"{found[0]}": write {better}'


def spelling() -> Iterator[str]:
    """What codespell finds, where it is installed."""
    if find_spec("codespell_lib") is None:
        print("spelling not checked: codespell is not installed (extra dev)")
        return
    argv = [sys.executable, "-m", "codespell_lib", f"--ignore-words-list={SPELT}", "--builtin=clear,rare"]
    paths = [
        *map(str, all_pages()),
        *(str(ROOT / name) for name in ("CHANGELOG.md", "jaxscan", "hardware", "examples")),
    ]
    skip = "--skip=*.js,*.css,*.html,*.svg"
    done = subprocess.run([*argv, skip, *paths], capture_output=True, text=True, check=False)
    yield from (f"spelling: {line.removeprefix(f'{ROOT}/')}" for line in done.stdout.splitlines())


if __name__ == "__main__":
    sys.exit(main())
