"""Rows of things that have two ends, such as branches and edges, each of which may go on into another one."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

Link = tuple[int, int]  # the number of a thing, and one of its ends, 0 or 1


def pairs_of(meetings: Iterable[list[Link]]) -> dict[Link, Link]:
    """Return for each end that meets just one other, at a place where ends meet, that other."""
    return {a: b for ends in meetings if len(ends) == 2 for a, b in (ends, ends[::-1])}


def rows_of(things: Iterable[int], partner: Mapping[Link, Link]) -> list[tuple[list[Link], bool]]:
    """Return the rows of things, by (thing, end at which it is entered), and whether each returns to its start.

    partner: for each end that goes on into another one, that one.
    """
    left = dict.fromkeys(things)
    starts = [(thing, end) for thing in left for end in (0, 1) if (thing, end) not in partner]
    rows: list[tuple[list[Link], bool]] = []
    for start in starts + [(thing, 0) for thing in left]:
        row, here = list[Link](), start
        while here[0] in left:
            del left[here[0]]
            row.append(here)
            leave = here[0], 1 - here[1]
            here = partner.get(leave, leave)
        if row:
            rows.append((row, here == row[0]))
    return rows
