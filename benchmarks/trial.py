"""A standing trial: random requests of every kind, each made in a process of its own and judged by code that did not make it.

    python -m benchmarks.trial --seed 1 --count 300 [--kind lattice] [--jobs 2]
    python -m benchmarks.trial --seed 1 --only 1234          # one request again, with what was said about it

A request ends as met and right, refused with a reason, or not met and said so. Anything else is a failure: silently wrong,
a foreign exception, a crash, a hang (120 s of CPU), or files left over.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import pickle
import resource
import signal
import sys
import tempfile
import traceback
import warnings
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.trial_crossings import draw_decimals, draw_shells, draw_struts
from benchmarks.trial_images import draw_image
from benchmarks.trial_requests import (
    Drawn,
    draw_blend,
    draw_domains,
    draw_field,
    draw_infill,
    draw_lattice,
    draw_malformed,
    draw_map,
    draw_recipe,
)
from benchmarks.trial_skins import draw_skin

KINDS: dict[str, Callable[[np.random.Generator], Drawn]] = {
    "lattice": draw_lattice,
    "map": draw_map,
    "infill": draw_infill,
    "domains": draw_domains,
    "field": draw_field,
    "recipe": draw_recipe,
    "blend": draw_blend,
    "malformed": draw_malformed,
    "image": draw_image,
    "skin": draw_skin,
    "struts": draw_struts,
    "shells": draw_shells,
    "decimals": draw_decimals,
}
SHARES = {
    "lattice": 5,
    "map": 2,
    "infill": 3,
    "domains": 1,
    "field": 2,
    "recipe": 3,
    "blend": 2,
    "malformed": 6,
    "image": 3,
    "skin": 2,
    "struts": 2,
    "shells": 1,
    "decimals": 2,
}

CPU_LIMIT = 120
JUDGE_LIMIT = 240  # CPU seconds of the judges, which mesh with gmsh, and probe part by part
WALL_LIMIT = 5 * (CPU_LIMIT + JUDGE_LIMIT)  # a request that waits for ever uses no CPU
MEMORY_LIMIT = 6 * 2**30

RIGHT, REFUSED, NOT_MET = "met and right", "refused", "not met, said so"
WRONG, FOREIGN, CRASH, HANG, LEFT = "SILENTLY WRONG", "foreign exception", "crash", "hang", "left-over files"
VERDICTS = (RIGHT, REFUSED, NOT_MET, WRONG, FOREIGN, CRASH, HANG, LEFT)
FAILURES = frozenset({WRONG, FOREIGN, CRASH, HANG, LEFT})


@dataclass(frozen=True)
class Verdict:
    """What became of a request, the words that go with it, CPU seconds, and the most memory (GiB), with those of its judge."""

    verdict: str
    words: str
    cpu: float = 0.0
    memory: float = 0.0


def draw(seed: int, number: int, only_kind: str | None = None) -> tuple[str, Drawn]:
    """The kind and the request of a number; the same for every run with this seed."""
    rng = np.random.default_rng([seed, number])
    shares = np.array([SHARES[k] for k in KINDS], float)
    kind = str(rng.choice(list(KINDS), p=shares / shares.sum()))
    kind = only_kind or kind
    return kind, KINDS[kind](rng)


def judge_here(request: Drawn) -> Verdict:
    """Make and judge a request in this process, in an empty folder of its own."""
    import tpmscad

    with tempfile.TemporaryDirectory(prefix="trial-") as name:
        folder = Path(name)
        os.environ["TMPDIR"] = tempfile.tempdir = str(folder)
        os.chdir(folder)
        try:
            met, why, judge = request.make(folder)
        except tpmscad.TpmscadError as error:
            left = {p.name for p in folder.iterdir()} - request.files
            left |= {n for n in ("made.step", "made.stl") if (folder / n).exists()} - {"made.step"}
            words = f"{type(error).__name__}: {error}"
            if len(str(error)) < 12:
                return Verdict(FOREIGN, f"no reason given: {words}")
            return Verdict(LEFT, f"{sorted(left)} after {words}") if left else Verdict(REFUSED, words)
        except MemoryError as error:
            return Verdict(FOREIGN, f"MemoryError: {error}")
        except Exception as error:
            where = traceback.extract_tb(error.__traceback__)[-1]
            return Verdict(FOREIGN, f"{type(error).__name__}: {error} ({Path(where.filename).name}:{where.lineno})")
        if left := {p.name for p in folder.iterdir()} - request.files:
            return Verdict(LEFT, str(sorted(left)))
        if not met:
            return Verdict(NOT_MET, why)
        used = resource.getrusage(resource.RUSAGE_SELF)
        limit_cpu(int(used.ru_utime + used.ru_stime) + JUDGE_LIMIT)
        faults = judge()
        return Verdict(WRONG, "; ".join(faults)) if faults else Verdict(RIGHT, "")


def limit_cpu(seconds: int) -> None:
    """Have the kernel end this process after so many CPU seconds in all; called a second time with a later limit."""
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, CPU_LIMIT + JUDGE_LIMIT + 5))


class Child:
    """A forked process that judges one request."""

    def __init__(self, seed: int, number: int, kind: str | None) -> None:
        self.number = number
        reading, writing = os.pipe()
        self.pid = os.fork()
        if self.pid:
            os.close(writing)
            self.pipe = reading
            return
        os.close(reading)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
        signal.signal(signal.SIGALRM, signal.SIG_DFL)
        signal.alarm(WALL_LIMIT)
        limit_cpu(CPU_LIMIT)
        resource.setrlimit(resource.RLIMIT_AS, (MEMORY_LIMIT, MEMORY_LIMIT))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        silent = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silent, 1)
        os.dup2(silent, 2)
        try:
            drawn_kind, request = draw(seed, number, kind)
            answer = drawn_kind, request.text, judge_here(request)
        except BaseException as error:
            answer = kind or "?", "the trial itself", Verdict(FOREIGN, f"in the trial: {type(error).__name__}: {error}")
        with os.fdopen(writing, "wb") as pipe:
            pickle.dump(answer, pipe)
        os._exit(0)

    def result(self) -> tuple[str, str, Verdict]:
        """The kind, the text and the verdict, once the process has ended."""
        with os.fdopen(self.pipe, "rb") as pipe:
            data = pipe.read()
        _, status, used = os.wait4(self.pid, 0)
        cpu, memory = used.ru_utime + used.ru_stime, used.ru_maxrss / 2**20
        if data:
            kind, text, verdict = pickle.loads(data)
            return kind, text, Verdict(verdict.verdict, verdict.words, cpu, memory)
        ended = os.WTERMSIG(status) if os.WIFSIGNALED(status) else -os.WEXITSTATUS(status)
        if ended in (signal.SIGXCPU, signal.SIGALRM, signal.SIGKILL) or cpu >= CPU_LIMIT - 1:
            return "?", "", Verdict(HANG, f"ended after {cpu:.0f} s of CPU", cpu, memory)
        return "?", "", Verdict(CRASH, f"ended by signal {ended}", cpu, memory)


def judge_requests(seed: int, numbers: range, kind: str | None, jobs: int) -> Iterator[tuple[int, str, str, Verdict]]:
    """Every request's number, kind, text and verdict, `jobs` at a time."""

    import tpmscad.recipe

    for name in tpmscad.__all__:
        getattr(tpmscad, name)  # the kernel and every module are loaded once, before the forks

    waiting = list(numbers)[::-1]
    running: list[Child] = []
    while waiting or running:
        while waiting and len(running) < jobs:
            running.append(Child(seed, waiting.pop(), kind))
        child = running.pop(0)
        found, text, verdict = child.result()
        if not text:
            with contextlib.suppress(Exception):
                found, request = draw(seed, child.number, kind)
                text = request.text
        yield child.number, found, text, verdict


def main(arguments: list[str] | None = None) -> int:
    """Print the table and the failures; 1 if there is any."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=100)
    parser.add_argument("--start", type=int, default=0)
    parser.add_argument("--only", type=int)
    parser.add_argument("--kind", choices=list(KINDS))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--verbose", action="store_true", help="every request, not only failures")
    given = parser.parse_args(arguments)
    numbers = range(given.start, given.start + given.count) if given.only is None else range(given.only, given.only + 1)
    warnings.simplefilter("ignore")
    table: Counter[tuple[str, str]] = Counter()
    cpu, memory, failures = 0.0, (0.0, -1), 0
    with contextlib.suppress(KeyboardInterrupt):  # the table of what was done so far
        for number, kind, text, verdict in judge_requests(given.seed, numbers, given.kind, given.jobs):
            table[kind, verdict.verdict] += 1
            cpu += verdict.cpu
            memory = max(memory, (verdict.memory, number))
            failed = verdict.verdict in FAILURES
            failures += failed
            if failed or given.verbose or given.only is not None:
                again = f"python -m benchmarks.trial --seed {given.seed} --only {number}" + (
                    f" --kind {given.kind}" if given.kind else ""
                )
                used = f"({verdict.cpu:.1f} s, {verdict.memory:.2f} GiB)"
                print(f"{verdict.verdict}: {verdict.words}\n    {text}\n    {again}   {used}", flush=True)
    print(
        f"\nseed {given.seed}, {table.total()} of the requests {numbers.start} to {numbers.stop - 1}: {cpu:.0f} s of CPU, "
        f"at most {memory[0]:.2f} GiB (request {memory[1]})"
    )
    width = max(map(len, KINDS)) + 2
    print(" " * width + "".join(f"{v:>19}" for v in VERDICTS))
    for kind in (*KINDS, "?"):
        if any(table[kind, v] for v in VERDICTS):
            print(f"{kind:<{width}}" + "".join(f"{table[kind, v]:>19}" for v in VERDICTS))
    print(f"{'all':<{width}}" + "".join(f"{sum(table[k, v] for k in (*KINDS, '?')):>19}" for v in VERDICTS))
    return 1 if failures else 0


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    sys.exit(main())
