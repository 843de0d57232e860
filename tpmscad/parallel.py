"""Work in pieces of fixed size, done here or by an executor's workers: the same pieces and so the same bits either way.

Any concurrent.futures.Executor does (on a cluster Dask's `Client.get_executor()`); without one a process pool is started where
there are enough pieces to pay for it. What is sent is a function and plain arrays; fields of functions that can't be sent are
worked on here.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

ITEMS_PER_TASK = 256
"""Patches or curves to a piece: a few tenths of a second of fitting."""

MIN_TASKS_FOR_POOL = 8
"""Pieces from which a pool of this machine's cores is started: its start takes about as long as fitting one."""

TaskRunner = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]
"""work(function, arguments) -> the function's results, in order."""


def run_serial(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
    """All of it one after the other in this process."""
    return [function(*each) for each in arguments]


@contextmanager
def task_runner(executor: Executor | None, sent: Any) -> Iterator[TaskRunner]:
    """Work by the executor, or by a pool of processes where that pays; `sent` is what every piece needs and must be picklable."""
    try:
        pickle.dumps(sent)
    except (pickle.PicklingError, AttributeError, TypeError):
        yield run_serial
        return
    pool: list[Executor] = [executor] if executor is not None else []
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    def work(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        if executor is None and (len(arguments) < MIN_TASKS_FOR_POOL or cores < 2):
            return run_serial(function, arguments)
        if not pool:
            pool.append(ProcessPoolExecutor(cores))
        return [f.result() for f in [pool[0].submit(function, *each) for each in arguments]]

    try:
        yield work
    finally:
        if executor is None and pool:
            pool[0].shutdown()
