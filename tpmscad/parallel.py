"""Lists of independent tasks, run in this process or by an executor, with the same results to the last bit.

Callers cut their work into batches of a fixed size, so the results do not depend on who runs them. Any
`concurrent.futures.Executor` serves (on a cluster Dask's `Client.get_executor()`); without one a process pool is started once
there are enough tasks to pay for it. A task is a function and arrays, sent by pickling; what cannot be pickled is run in this
process.
"""

from __future__ import annotations

import os
import pickle
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from typing import Any

from tpmscad._typing import IntArray

MIN_TASKS_FOR_POOL = 8
"""Least number of tasks for which a process pool is started: its start takes about as long as one task."""

TaskRunner = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]
"""run_tasks(function, arguments): the results of the function for each tuple of arguments, in order."""


def run_serial(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Results of the tasks, run one after the other in this process."""
    return [function(*each) for each in arguments]


def split_batches(numbers: IntArray, size: int) -> list[IntArray]:
    """Consecutive batches of at most `size` of the numbers (n,)."""
    return [numbers[i : i + size] for i in range(0, len(numbers), size)]


@contextmanager
def task_runner(executor: Executor | None, shared_argument: Any) -> Iterator[TaskRunner]:
    """A runner that uses the executor, or a process pool of its own where that pays, as a context.

    `shared_argument` is part of every task. If it cannot be pickled, the tasks are run in this process.
    """
    try:
        pickle.dumps(shared_argument)
    except (pickle.PicklingError, AttributeError, TypeError):
        yield run_serial
        return
    pool: list[Executor] = [executor] if executor is not None else []
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1

    def run_tasks(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
        if executor is None and (len(arguments) < MIN_TASKS_FOR_POOL or cores < 2):
            return run_serial(function, arguments)
        if not pool:
            pool.append(ProcessPoolExecutor(cores))
        return [f.result() for f in [pool[0].submit(function, *each) for each in arguments]]

    try:
        yield run_tasks
    finally:
        if executor is None and pool:
            pool[0].shutdown()
