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
from concurrent.futures import BrokenExecutor, Executor, Future, ProcessPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager, nullcontext
from multiprocessing import get_context
from typing import Any, TypeVar

from threadpoolctl import threadpool_limits

from tpmscad._typing import IntArray
from tpmscad.errors import TpmscadError

MIN_TASKS_FOR_POOL = 8
"""Least number of tasks for which a process pool is started: its start takes about as long as one task."""

T = TypeVar("T")

TaskRunner = Callable[[Callable[..., Any], Sequence[tuple[Any, ...]]], list[Any]]
"""run_tasks(function, arguments): the results of the function for each tuple of arguments, in order."""


def run_serial(function: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> list[Any]:
    """Results of the tasks, run one after the other in this process."""
    return [function(*each) for each in arguments]


def run_as_completed(
    executor: Executor | None,
    function: Callable[..., T],
    arguments: Sequence[tuple[Any, ...]],
    on_failure: Callable[[Exception], T] | None = None,
) -> Iterator[tuple[int, T]]:
    """The results of the tasks with their numbers, each as soon as it is there: from the executor, or one by one without it.

    `on_failure` gives the result of a task that fails, or that the executor gives up, as Dask does if its workers die of it. If
    the caller stops early, or a task fails without it, the tasks that have not begun are cancelled. TpmscadError if a process of
    a pool ends before its task does, as the pool then loses all tasks.
    """
    if executor is None:
        yield from ((number, function(*each)) for number, each in enumerate(arguments))
        return
    number_of: dict[Future[T], int] = {executor.submit(function, *each): n for n, each in enumerate(arguments)}
    try:
        for future in as_completed(number_of):
            yield number_of[future], _result_of(future, on_failure)
    except BrokenExecutor as error:
        raise TpmscadError(
            f"a process of the executor ended before its task ({error}), for want of memory perhaps: take fewer processes, or "
            "smaller parts"
        ) from error
    finally:
        for future in number_of:
            future.cancel()


def _result_of(future: Future[T], on_failure: Callable[[Exception], T] | None) -> T:
    """The result of a finished task, or what stands for it."""
    try:
        return future.result()
    except BrokenExecutor:
        raise
    except Exception as error:
        if on_failure is None:
            raise
        return on_failure(error)


def start_processes(jobs: int) -> AbstractContextManager[Executor | None]:
    """A pool of so many processes as a context; nothing for one, whose work this process does.

    The processes start afresh, so that they hold no memory of this one.
    """
    if jobs < 2:
        return nullcontext()
    return ProcessPoolExecutor(jobs, mp_context=get_context("spawn"))


def limit_blas_threads() -> AbstractContextManager[Any]:
    """A context in which BLAS works in one thread.

    For work of many small matrices: threads that wait for each other take up to three times the CPU seconds, and no less time.
    """
    return threadpool_limits(limits=1, user_api="blas")


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
