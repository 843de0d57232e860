"""What the tables of refusals share."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from tpmscad.errors import TpmscadError

Row = tuple[Callable[[], Any], str]


def check_refusal(row: Row, kind: type[TpmscadError]) -> None:
    """The request is refused with an error of this kind whose message matches; nothing else is raised."""
    request, words = row
    with pytest.raises(TpmscadError, match=words) as caught:
        request()
    assert isinstance(caught.value, kind)
    assert len(str(caught.value)) > 15
