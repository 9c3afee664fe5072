"""What puts a list of names into another order, in words: the fewest that have to be exchanged or moved."""

from bisect import bisect_left
from collections.abc import Hashable, Sequence
from typing import Final, TypeVar

from jaxscan.phrases import first_few

# Up to this number of photographs that moved, and up to a third of all, each is named; of more the whole order is said.
_NAMED: Final = 5
_ORDER_NAMED: Final = 40

# In another order places must be nearer to where step counts say by so much.
NEARER: Final = 0.3

Name = TypeVar("Name", bound=Hashable)


def correction(names: Sequence[str], by_place: Sequence[str]) -> str:
    """What puts names into another order of them, in words: two to exchange, the fewest to move, or the whole order."""
    wrong = [name for name, right in zip(names, by_place, strict=True) if name != right]
    if len(wrong) == 2:
        return f"if {wrong[0]} and {wrong[1]} were exchanged"
    fewest = fewest_to_move(names, by_place)
    moved = [name for name in by_place if name in fewest]
    if len(moved) > min(_NAMED, len(by_place) // 3):
        return f"if they were in the order {first_few(by_place, _ORDER_NAMED)}"
    places = []
    for name in moved:
        at = by_place.index(name)
        before, behind = by_place[at - 1 : at], by_place[at + 1 : at + 2]
        if before and behind:
            places.append(f"{name} were between {before[0]} and {behind[0]}")
        else:
            places.append(f"{name} were {'last' if before else 'first'}")
    return f"if {', and '.join(places)}"


def fewest_to_move(names: Sequence[Name], by_place: Sequence[Name]) -> set[Name]:
    """The smallest set of names such that the others already stand in the other order: all but a longest rising run."""
    rank = {name: i for i, name in enumerate(by_place)}
    ends: list[int] = []
    last: list[Name] = []
    before: dict[Name, Name | None] = {}
    for name in names:
        at = bisect_left(ends, rank[name])
        ends[at:], last[at:] = [rank[name], *ends[at + 1 :]], [name, *last[at + 1 :]]
        before[name] = last[at - 1] if at else None
    stays: set[Name] = set()
    name = last[-1] if last else None
    while name is not None:
        stays.add(name)
        name = before[name]
    return set(names) - stays
