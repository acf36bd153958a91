"""What a topic is made of."""

import ctypes
from dataclasses import dataclass
from typing import Union


class Record(ctypes.Structure):
    """One part of a message: plain data of a fixed layout, as it lies in shared memory."""

    @classmethod
    def type_name(cls) -> str:
        """The name under which iceoryx2 knows the type; it carries the version."""
        return cls.TYPE_NAME

    def __repr__(self) -> str:
        return f"{type(self).__name__}({', '.join(f'{k}={v!r}' for k, v in to_dict(self).items())})"


@dataclass(frozen=True)
class Topic:
    """A topic: its records, the hash of their layout, and how it is delivered."""

    name: str
    meta: type
    item: type
    # Two builds that agree on it agree on every field.
    schema_hash: str
    # "wait", "drop" or "supersede": what happens to a reader that lags.
    lag: str
    # Most items of a message: a number, "scan" (points of the largest scan) or "keyframes" (twice that, at most 200,000).
    capacity: Union[int, str]

    def most_items(self, max_points: int) -> int:
        """Most items of a message in a graph whose largest scan has `max_points` points."""
        if self.capacity == "scan":
            return max(max_points, 1)
        if self.capacity == "keyframes":
            return min(max(2 * max_points, 1), 200_000)
        return self.capacity


def text(field) -> str:
    """The text in a field of bytes, up to the first zero."""
    return bytes(field).split(b"\0", 1)[0].decode("utf-8", "replace")


def to_dict(record) -> dict:
    """A record as a dictionary: arrays as lists, fields of bytes as text."""

    def value(v):
        if isinstance(v, ctypes.Structure):
            return to_dict(v)
        if isinstance(v, ctypes.Array):
            return text(v) if v._type_ is ctypes.c_uint8 else [value(x) for x in v]
        return v

    return {name: value(getattr(record, name)) for name, _ in record._fields_}
