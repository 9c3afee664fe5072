"""How easy a page is to read: R. Flesch's reading ease (1948) of its prose.

    206.835 − 1.015 · words / sentences − 84.6 · syllables / words

100 is a comic, 60 plain English, 50 a good manual, 30 a paper. What is no prose is left out: code, formulas, tables,
headings, addresses of links, comments. A full stop, a question mark, an exclamation mark, or the end of a paragraph
or of a list's item ends a sentence; colons and semicolons do not.
"""

import re
from typing import NamedTuple

# What is no prose, in the order in which it is taken out of a page.
_NO_PROSE = (
    re.compile(r"^```.*?^```$", re.M | re.S),
    re.compile(r"<!--.*?-->", re.S),
    re.compile(r"^ {4,}\S.*$", re.M),
    re.compile(r"^(?:#|::: ).*$", re.M),
    re.compile(r"^\|.*$", re.M),
    re.compile(r"!\[[^\]]*\]\([^)]*\)"),
    re.compile(r"``?[^`]+``?"),
)
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_ITEM = re.compile(r"^\s*(?:[-*]|\d+\.)\s+", re.M)
# A number's point ends no sentence, nor does that of these.
_NO_END = re.compile(r"(?<=\d)\.(?=\d)|\b(?:e\.g|i\.e|cf|vs|etc|[A-Z])\.(?=\s+\S)")
_WORD = re.compile(r"[^\W\d_]+(?:['’-][^\W\d_]+)*")
_SILENT = re.compile(r"[^aeiouyl]e$|[aeiouy]le$|[^aeiouytd]ed$|[^aeiouycgsxzh]es$|[^cs]hes$")
_VOWELS = re.compile(r"[aeiouyäöüéè]+")


class Reading(NamedTuple):
    """What was counted in a text."""

    words: int
    sentences: int
    syllables: int

    @property
    def ease(self) -> float:
        """Flesch's reading ease; 100 of a text without words."""
        if not self.words:
            return 100.0
        return 206.835 - 1.015 * self.words / self.sentences - 84.6 * self.syllables / self.words


def reading(markdown: str) -> Reading:
    """Count the prose of a page."""
    words = sentences = syllables = 0
    for sentence in prose(markdown):
        found = _WORD.findall(sentence)
        words += len(found)
        sentences += bool(found)
        syllables += sum(map(syllables_of, found))
    return Reading(words, sentences, syllables)


def prose(markdown: str) -> list[str]:
    """The sentences of a page."""
    for pattern in _NO_PROSE:
        markdown = pattern.sub("", markdown)
    markdown = _ITEM.sub("\n\n", _LINK.sub(r"\1", markdown))
    markdown = _NO_END.sub(" ", markdown)
    parts = re.split(r"\n\s*\n|(?<=[.?!])[)\"'*”]*\s+", markdown)
    return [" ".join(part.split()) for part in parts if part.strip()]


def syllables_of(word: str) -> int:
    """How many syllables a word has, by rule: groups of vowels, without a silent e; right for nine words in ten."""
    count = 0
    for part in re.split(r"['’-]", word.lower()):
        groups = len(_VOWELS.findall(part))
        # made, makes, walked; not table, boxes, painted
        groups -= bool(_SILENT.search(part))
        # ma-te-ri-al, mil-li-on-s are two; sta-tion, spe-cial are one
        groups += len(re.findall(r"i(?:a|o|u)(?!u)(?<![tcsg]i[ao])|ua(?=[lt])|eo(?=m)|(?<=[^aeiou])ying$", part))
        count += max(groups, 1 if part else 0)
    return max(count, 1)
