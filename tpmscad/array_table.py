"""Tables of arrays: many items of one kind as a record of columns, which are selected and concatenated row by row."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Self

import numpy as np


class ArrayTable:
    """Base of frozen dataclasses with slots whose fields are columns: arrays, or tables, with a row for each of n items."""

    __slots__: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(getattr(self, self.__slots__[0]))

    def __getitem__(self, key: Any) -> Self:
        return type(self)(*(getattr(self, name)[key] for name in self.__slots__))

    @classmethod
    def concatenate(cls, parts: Sequence[Self]) -> Self:
        """The rows of several tables, one after another."""
        columns = ([getattr(part, name) for part in parts] for name in cls.__slots__)
        return cls(*(type(c[0]).concatenate(c) if isinstance(c[0], ArrayTable) else np.concatenate(c) for c in columns))
