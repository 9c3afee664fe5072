"""Mutations of files: of bytes, of words of a text, and of the tree of values that a text stands for.

All of them take a `random.Random`, so that a case is its reader's name and a number.
"""

import copy
import json
import re
import struct
from random import Random
from typing import Any

Bytes = bytes

_EDGES = (0, 1, -1, 127, 128, 255, 256, 32767, 32768, 65535, 65536, 2**31 - 1, -(2**31), 2**32 - 1, 2**40, 2**63 - 1)
# Numbers at which something overflows, vanishes or is none.
NUMBERS: tuple[Any, ...] = (
    0, -1, 1, 2, 3, 7, 1e-320, -1e-320, 5e-324, 1e-45, 1e-39, 1e-30, 1e-18, 1e-9, 0.5, 1e9, 1e17, 1e19, 3.5e38,
    1e39, 1e154,
    1e200, 1e300,
    1.7976931348623157e308, -1e300, 2**31, 2**53, 2**53 + 1, 2**63, 2**64, 10**30, 10**300, 10**400,
    float("nan"), float("inf"), float("-inf"), -0.0, 640, 479.5, 99999,
)  # fmt: skip
_STRINGS = (
    "", " ", "\0", "a\nb", "é", "😀", "\ud800", "../..", "/", ".", "~", "*", "**/*", "**/**/**/**", "[", "[z-a]*",
    "?" * 50,
    "a" * 300, "a/" * 3000, "true", "1e5", "nan", "stage", "turntable", "plane", "bowed", "linear", "rotary", "screw",
    "growing", "guide", "fisheye", "rational", "radial3", "brown", "none", "charuco", "circles", "checkerboard",
    "DICT_4X4_50", "red", "x" * 100_000,
)  # fmt: skip
# Words that some YAML, TOML, JSON, XML or Python reader takes for more than a text.
_WORDS = (
    "!!int ''", "!!int q", "!!bool q", "!!float ''", "!!timestamp z", "!!binary '*'", "!!null x", "!!set {a}",
    "!!omap [a]",
    "!!pairs [a]", "!!python/object:os.system x", "!!opencv-matrix", "!!opencv-nd-matrix [1]", "!x", "!<tag:x>",
    "! a",
    "&a", "*a", "&a [*a]", "<<: *a", "<<: {a: 1}", "<<: 3", "? ", "? [a]: b", "[a]: b", "{a: 1}: b", "- ", "---",
    "...", "%YAML 9.9",
    "%TAG ! !", "|", ">", "|9", "'", '"', "\\x", '"\\ud800"', '"\\U00110000"', "\t", "#", "{", "}", "[", "]", ",",
    ":", "=", "==",
    "2001-01-01", "2001-99-99", "2001-02-30T25:61:61Z", "1:60:60", "0x", "0x1f", "0o17", "017", "0b2", "1_000",
    "1__0", "_", ".", "..",
    "+", "-", "1e", "1e400", "-.inf", ".NaN", "~", "null", "yes", "NO", "inf", "nan", "1e-320", "9" * 400,
    "9" * 5000, "[" * 200,
    "{" * 200, "[" * 20_000, "(" * 300, "-" * 5000, "a." * 2000, "1j", "1+1j", "b'x'", "'\\d'", "0777",
    "1if 1else 2", "None", "{1: 2}",
    "{[]: 1}", "{**{}}", "f'{1}'", "<a>", "</a>", "&lt;", "&x;", "<!DOCTYPE a [<!ENTITY x 'y'>]>", "<!--",
    "<![CDATA[", "&#0;",
)  # fmt: skip


def of_bytes(data: Bytes, random: Random) -> Bytes:
    """A few bytes other, cut, doubled, moved, or edge numbers of 1 to 8 bytes put over them."""
    out = bytearray(data)
    for _ in range(random.choice((1, 1, 1, 2, 3, 8))):
        if not out:
            return bytes(out)
        # Headers stand in front.
        reach = random.choice((16, 64, 256, len(out), len(out)))
        at = random.randrange(min(reach, len(out)))
        match random.randrange(8):
            case 0:
                out[at] = random.randrange(256)
            case 1:
                out[at] ^= 1 << random.randrange(8)
            case 2 | 3:
                code, edge = random.choice("bhiq"), random.choice(_EDGES)
                size = struct.calcsize(code)
                edge %= 1 << 8 * size
                out[at : at + size] = edge.to_bytes(size, random.choice(("little", "big")))
            case 4:
                del out[at : at + random.choice((1, 2, 4, 8, 64, len(out)))]
            case 5:
                length = random.choice((1, 4, 16, 256))
                out[at:at] = out[at : at + length] * random.choice((1, 2, 50))
            case 6:
                out[at:at] = random.randbytes(random.choice((1, 4, 16, 200)))
            case _:
                del out[at:]
    return bytes(out)


def of_text(text: str, random: Random) -> str:
    """Words and numbers of a text others, lines doubled or gone."""
    for _ in range(random.choice((1, 1, 2, 3))):
        places = list(re.finditer(r"[A-Za-z_][\w.]*|[-+]?\d[\d.eE+-]*|[^\w\s]|\n", text))
        if not places:
            return text
        place = random.choice(places)
        new = random.choice((_hostile_word, _hostile_number, _other_word))(random, places)
        match random.randrange(5):
            case 0:
                text = text[: place.start()] + new + text[place.start() :]
            case 1:
                text = text[: place.start()] + text[place.end() :]
            case 2:
                lines = text.split("\n")
                at = random.randrange(len(lines))
                lines[at : at + random.choice((0, 1, 3))] = [lines[random.randrange(len(lines))]] * random.choice(
                    (0, 1, 2)
                )
                text = "\n".join(lines)
            case _:
                text = text[: place.start()] + new + text[place.end() :]
    return text


def _hostile_word(random: Random, _: list[re.Match[str]]) -> str:
    return random.choice(_WORDS)


def _hostile_number(random: Random, _: list[re.Match[str]]) -> str:
    return str(random.choice(NUMBERS))


def _other_word(random: Random, places: list[re.Match[str]]) -> str:
    return random.choice(places).group()


def of_tree(tree: Any, random: Random) -> Any:
    """Some values of a tree of tables and lists others, doubled, moved or gone."""
    tree = copy.deepcopy(tree)
    for _ in range(random.choice((1, 1, 1, 2, 4))):
        places = list(_places(tree))
        if not places:
            return tree
        holder, key = random.choice(places)
        match random.randrange(9):
            case 0:
                del holder[key]
            case 1 if isinstance(holder, list):
                holder[key:key] = [holder[key]] * random.choice((1, 2, 300))
            case 1 | 2:
                other, other_key = random.choice(places)
                holder[key] = copy.deepcopy(other[other_key])
            case 3 if isinstance(holder, dict):
                holder[random.choice(_STRINGS)] = holder[key]
            case _:
                holder[key] = hostile_value(random, holder[key])
    return tree


def hostile_value(random: Random, old: Any) -> Any:
    """A value instead of another, mostly of its kind."""
    if isinstance(old, list) and old and random.random() < 0.5:
        return [hostile_value(random, value) if random.random() < 0.5 else value for value in old]
    if isinstance(old, int | float) and not isinstance(old, bool) and random.random() < 0.8:
        return random.choice(NUMBERS) if random.random() < 0.8 else old * random.choice((-1, 1e3, 1e-3, 1e12, 1e-12))
    if isinstance(old, str) and random.random() < 0.7:
        return random.choice(_STRINGS)
    return random.choice(
        (
            *(None, True, False, [], {}, [[]], [{}], {"": {}}, [0], [None], [1, "a"], [1] * 5000),
            *(_deep(random), random.choice(_STRINGS), random.choice(NUMBERS)),
            [random.choice(NUMBERS)] * random.choice((1, 2, 3, 9)),
        )
    )


def _deep(random: Random) -> Any:
    value: Any = 0
    for _ in range(random.choice((3, 60, 400))):
        value = [value] if random.random() < 0.5 else {"a": value}
    return value


def _places(tree: Any) -> Any:
    pending = [tree]
    while pending:
        holder = pending.pop()
        keys = list(holder) if isinstance(holder, dict) else range(len(holder))
        for key in keys:
            yield holder, key
            if isinstance(holder[key], dict | list):
                pending.append(holder[key])


def of_json(tree: Any, random: Random) -> str:
    """JSON of a mutated tree, at times a mutated text of it."""
    try:
        text = json.dumps(of_tree(tree, random))
    except (RecursionError, ValueError):
        text = json.dumps(tree)
    return of_text(text, random) if random.random() < 0.2 else text
