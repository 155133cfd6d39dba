"""HID report descriptors, as far as feature reports need them: which field stands where."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Final

_MAIN_ITEMS: Final = (0x80, 0x90, 0xB0, 0xA0, 0xC0)  # input, output, feature, collection, its end
_LONG_ITEM: Final = 0xFE
_CONSTANT: Final = 0x01


@dataclass(frozen=True, slots=True)
class Field:
    """One value in a feature report.

    Attributes
    ----------
    usage : int
        Usage page in the upper 16 bits, usage in the lower; 0 for padding.
    bits : int
        Its size.
    """

    usage: int
    bits: int


@dataclass(slots=True)
class FeatureReport:
    """A feature report.

    Attributes
    ----------
    number : int
        Its id, 0 where reports have none.
    collection : int
        Usage of the innermost collection in which it begins.
    fields : list of Field
        In their order.
    """

    number: int
    collection: int
    fields: list[Field] = field(default_factory=list)

    @property
    def size(self) -> int:
        """Size in bytes, with the id."""
        return 1 + sum(each.bits for each in self.fields) // 8


@dataclass(slots=True)
class _State:
    page: int = 0
    size: int = 0
    count: int = 0
    number: int = 0


def feature_reports(descriptor: bytes) -> list[FeatureReport]:
    """Every feature report of a descriptor, in the order of their first fields.

    Raises
    ------
    ValueError
        If the descriptor ends in the middle of an item, or its collections or stack do not match.
    """
    reports: dict[int, FeatureReport] = {}
    state, stack = _State(), []
    usages: list[int] = []
    collections: list[int] = []
    least = 0
    for item, value, size in _items(descriptor):
        whole_usage = value if size == 4 else state.page << 16 | value
        match item:
            case 0x04:  # usage page
                state.page = value
            case 0x74:  # report size
                state.size = value
            case 0x84:  # report id
                state.number = value
            case 0x94:  # report count
                state.count = value
            case 0xA4:  # push
                stack.append(_State(state.page, state.size, state.count, state.number))
            case 0xB4:  # pop
                if not stack:
                    raise ValueError("pop without push")
                state = stack.pop()
            case 0x08:  # usage
                usages.append(whole_usage)
            case 0x18:  # usage minimum
                least = whole_usage
            case 0x28:  # usage maximum
                usages += range(least, whole_usage + 1)
            case 0xA0:  # collection
                collections.append(usages[0] if usages else 0)
            case 0xC0:  # end of collection
                if not collections:
                    raise ValueError("a collection ends without a beginning")
                collections.pop()
            case 0xB0:  # feature
                report = reports.setdefault(
                    state.number, FeatureReport(state.number, collections[-1] if collections else 0)
                )
                named = [0] * state.count if value & _CONSTANT else _for_each(usages, state.count)
                report.fields += [Field(usage, state.size) for usage in named]
        if item in _MAIN_ITEMS:
            usages = []
    if collections:
        raise ValueError("a collection does not end")
    return list(reports.values())


def _for_each(usages: list[int], count: int) -> list[int]:
    """A usage for each value: the last one repeats."""
    last = usages[-1] if usages else 0
    return (usages + [last] * count)[:count]


def _items(descriptor: bytes) -> list[tuple[int, int, int]]:
    """Tag and type, value and size of each short item; long ones are passed over."""
    items, place = [], 0
    while place < len(descriptor):
        prefix = descriptor[place]
        if prefix == _LONG_ITEM:
            place += 3 + descriptor[place + 1] if place + 1 < len(descriptor) else 3
            continue
        size = (0, 1, 2, 4)[prefix & 3]
        data = descriptor[place + 1 : place + 1 + size]
        if len(data) < size:
            raise ValueError("ends in the middle of an item")
        items.append((prefix & 0xFC, int.from_bytes(data, "little"), size))
        place += 1 + size
    return items
