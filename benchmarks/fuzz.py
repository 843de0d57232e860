"""Values of every kind through every public signature: each call gives a result or a TpmscadError, never a foreign exception.

    python -m benchmarks.fuzz --seed 1 --count 100000

The functions are found by introspection of the public modules. The arguments are the examples of their declarations,
of which one or two are replaced by hostile values; those that would take long are made cheap by arguments that are refused late
(`CHEAP`). A field that comes back is evaluated, too. A CPU limit holds for each call. Every kind of failure is printed once,
with a line that reproduces it; the exit status is 1 if there is one.
"""

from __future__ import annotations

import argparse
import signal
import sys
import time
import traceback
import types
import warnings
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from decimal import Decimal
from fractions import Fraction
from importlib import import_module
from inspect import Parameter
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad import fields, maps
from tpmscad.api.argument_kinds import show_value
from tpmscad.api.arguments import Argument, arguments_of
from tpmscad.errors import TpmscadError, UnexpectedError

CPU_LIMIT = 3.0
"""Seconds of CPU time of one call."""

MODULES = (
    "tpmscad.fields",
    "tpmscad.maps",
    "tpmscad.surfaces",
    "tpmscad.topology",
    "tpmscad.blending",
    "tpmscad",
)

CHEAP: Mapping[str, Mapping[str, Any]] = {
    "lattice": {"cell": 10.0, "thickness": 1.0, "volume_fraction": 0.3},
    "export_slabs": {"cell": 10.0, "thickness": 1.0, "volume_fraction": 0.3},
    "solidify": {"field": 1.0, "tol": 0.5},
    "preview_solid": {"field": 1.0, "tol": 0.5},
    "blend": {"structures": [1.0, -1.0], "resolution": (4, 4, 4)},
    "sweep": {"table": []},
    "homogenize": {"surface": "gyroid", "volume_fraction": 2.0, "kind": "rod"},  # two faults: valid calls take longer
    "design_for": {"surface": "octet", "property": "permeability"},  # which is refused
    "threshold_for": {"samples": 8},
    "graded_threshold": {"phi": 1.0},
    "volume_fraction": {"samples": 8},
    "scattered": {"resolution": 8},
    "image_region": {"mask": np.arange(16).reshape(4, 4) > 7},
    **{
        name: {"values": np.arange(64.0).reshape(4, 4, 4) - 30}
        for name in (
            "betti",
            "bound_component_counts",
            "compute_pairs_at_level",
            "compute_persistence",
            "count_components_and_cavities",
            "euler_characteristic",
        )
    },
    "persistence_diagram": {"field_or_values": np.arange(64.0).reshape(4, 4, 4) - 30},
}
"""Arguments of functions that would take long: most are refused, but only after all others have been looked at."""

NAMESPACE = {"np": np, "fields": fields, "maps": maps, "ProcessPoolExecutor": ProcessPoolExecutor}
"""What the examples of the table refer to."""


class Unprintable:
    """An object that cannot be shown, compared or converted."""

    def __repr__(self) -> str:
        raise ValueError("no repr")

    def __float__(self) -> float:
        raise RuntimeError("no float")


def raising(*_: Any) -> Any:
    """A function that fails."""
    raise KeyError("of a user")


HOSTILE: tuple[Any, ...] = (
    None,
    True,
    False,
    np.True_,
    0,
    1,
    -1,
    2,
    7,
    10**400,
    -(10**19),
    2**63,
    0.0,
    -0.0,
    0.5,
    -3.7,
    5.0,
    1e-320,
    1e-9,
    1e9,
    1e99,
    1e150,
    1e308,
    -1e308,
    float("nan"),
    float("inf"),
    float("-inf"),
    1 + 2j,
    np.float32(0.25),
    np.int8(3),
    np.float64("nan"),
    np.array(2.5),
    np.array([]),
    np.array([1.0, 2.0, 3.0]),
    np.array(["a", "b", "c"]),
    np.array([1, None, 3], dtype=object),
    np.array([True, False, True]),
    np.zeros((2, 3)),
    np.array([[0.0, 0, 0], [5, 5, 5]]),
    np.full((4, 4, 4), np.nan),
    np.zeros((4, 4, 4)),
    np.arange(64.0).reshape(4, 4, 4) - 30,
    np.arange(125.0, dtype=np.float32).reshape(5, 5, 5) > 60,
    np.zeros((0, 3)),
    np.zeros((3, 3, 3, 3)),
    np.datetime64("2020-01-01"),
    Decimal("1.5"),
    Decimal("NaN"),
    Fraction(1, 3),
    b"10",
    bytearray(b"x"),
    "",
    "10",
    "gyroid",
    "x",
    "-y",
    "w",
    "sheet",
    "nan",
    "/nowhere/part.step",
    "\0",
    "ä" * 300,
    Path("absent.step"),
    Path("/"),
    [],
    (),
    {},
    set(),
    {"x": 1},
    [1],
    [1, 2],
    (1, 2, 3),
    [1.5, 2.5, 3.5],
    (0, 0, 0),
    (1, float("nan"), 3),
    (1, "2", 3),
    (True, True, True),
    (1, 2, 3, 4),
    [[1, 2, 3], [4, 5, 6]],
    ((0, 0, 0), (10, 10, 10)),
    ((0, 0, 0), (1e99, 1, 1)),
    ((0, 0, 0), (1e-9, 1, 1)),
    ((5, 5, 5), (1, 1, 1)),
    [[1, 2], [3]],
    [[[[]]]],
    range(3),
    object(),
    Unprintable(),
    int,
    type,
    np,
    len,
    raising,
    lambda: 1.0,
    lambda p: p,
    lambda p: p[..., 0],
    lambda p: 0.0 * p,
    lambda p: p[..., 0] * np.nan,
    lambda p: "text",
    lambda p: None,
    lambda p: np.zeros(len(p)),
    lambda x, y: x,
    lambda x, y, z: x + y - z,
    lambda x, y, z: 1 / 0,
    lambda *a: a,
    fields.tpms("gyroid"),
    fields.constant(0.0),
    fields.sphere((0, 0, 0), 5),
    maps.cylinder(20),
    iter([1, 2, 3]),
    (i for i in range(3)),
    TpmscadError("passed as a value"),
)
"""Values that a person, a file or a program might pass by mistake or on purpose."""


class TimeLimit(BaseException):
    """The CPU limit of a call."""


@dataclass(frozen=True, slots=True)
class Target:
    """A public function, and the arguments of a call that is cheap."""

    name: str
    function: Callable[..., Any]
    base: Mapping[str, Any]
    arguments: tuple[str, ...]


@dataclass(slots=True)
class Tally:
    """What came of the calls, and a reproduction of every kind of failure."""

    outcomes: Counter[str] = field(default_factory=Counter)
    failures: dict[str, str] = field(default_factory=dict)
    counts: Counter[str] = field(default_factory=Counter)


def evaluate_example(argument: Argument) -> Any:
    """The example of an argument as a value."""
    return eval(argument.kind.example, NAMESPACE) if argument.kind.example else None


def find_targets() -> Iterator[Target]:
    """Every function and class that the public modules list and that has passed the decorator of the door."""
    seen = set()
    for module in MODULES:
        home = import_module(module)
        for name in home.__all__:
            value = getattr(home, name)
            call = value.__init__ if isinstance(value, type) else value
            if not hasattr(call, "__wrapped__") or isinstance(value, types.ModuleType) or id(value) in seen:
                continue
            seen.add(id(value))
            declared = arguments_of(value).values()
            named = [a.name for a in declared if a.passed in (Parameter.POSITIONAL_OR_KEYWORD, Parameter.KEYWORD_ONLY)]
            base = {a.name: evaluate_example(a) for a in declared if a.is_required} | dict(CHEAP.get(name, {}))
            spread = tuple(a.name for a in declared if a.passed is Parameter.VAR_POSITIONAL)
            yield Target(f"{home.__name__}.{name}", value, base, (*named, *spread))


def interrupt(*_: Any) -> None:
    """End the call that runs."""
    raise TimeLimit


def use(result: Any) -> None:
    """Evaluate a field or a map that was made."""
    if isinstance(result, fields.Field):
        result((1.0, 2.0, 3.0))
        result.gradient([[0.0, 0.0, 0.0], [4.0, 5.0, 6.0]])
    elif isinstance(result, maps.Map):
        result(np.ones((2, 3)))
        result.jacobian(np.ones((2, 3)), 1.0)


def attempt(target: Target, given: Mapping[str, Any], limit: float = CPU_LIMIT) -> tuple[str, str]:
    """What came of one call: "result", "refusal", "time limit" or "failure", and of the last the kind; no limit if 0."""
    spread = [given[key] for key in given if key in ("fields", "taken") and target.name.endswith(("ion", "difference"))]
    named = {key: value for key, value in given.items() if not (spread and key in ("fields", "taken"))}
    signal.setitimer(signal.ITIMER_VIRTUAL, limit)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            if spread:
                first = [named.pop("field")] if "field" in named else []
                use(target.function(*first, *spread, spread[0], **named))
            else:
                use(target.function(**named))
    except TimeLimit:
        return "time limit", f"{target.name}: time limit"
    except UnexpectedError as error:
        return "failure", kind_of(target, error.__cause__ or error)
    except TpmscadError as error:
        return (
            ("refusal", "") if str(error) else ("failure", f"{target.name}: {type(error).__name__} without a message")
        )
    except Exception as error:
        return "failure", kind_of(target, error)
    finally:
        signal.setitimer(signal.ITIMER_VIRTUAL, 0)
    return "result", ""


def kind_of(target: Target, error: BaseException) -> str:
    """The function, the exception and the place where it arose."""
    frames = [f for f in traceback.extract_tb(error.__traceback__) if "tpmscad" in f.filename] or [None]
    where = f"{Path(frames[-1].filename).name}:{frames[-1].lineno}" if frames[-1] else "outside"
    return f"{target.name}: {type(error).__name__} at {where}: {str(error)[:90]}"


def run(seed: int, count: int) -> Tally:
    """`count` calls with hostile values, the same ones for the same seed."""
    signal.signal(signal.SIGVTALRM, interrupt)
    rng = np.random.default_rng(seed)
    targets, tally = [t for t in find_targets() if t.arguments], Tally()
    for (
        target
    ) in targets:  # compiles what the calls need: a compilation that the limit interrupts leaves a function unusable
        attempt(target, target.base, limit=0.0)
    for _ in range(count):
        target = targets[rng.integers(len(targets))]
        chosen = rng.choice(
            target.arguments, size=min(len(target.arguments), 1 + int(rng.random() < 0.3)), replace=False
        )
        given = {**target.base, **{str(key): HOSTILE[rng.integers(len(HOSTILE))] for key in chosen}}
        outcome, kind = attempt(target, given)
        tally.outcomes[outcome] += 1
        if kind:
            tally.counts[kind] += 1
            shown = ", ".join(f"{key}={show_value(value)}" for key, value in given.items())
            tally.failures.setdefault(kind, f"{target.name}({shown})")
    return tally


def main() -> int:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--count", type=int, default=20_000)
    options = parser.parse_args()
    begun = time.process_time()
    tally = run(options.seed, options.count)
    for kind, count in tally.counts.most_common():
        print(f"{count:6} {kind}\n       {tally.failures[kind]}")
    names = ", ".join(f"{tally.outcomes[name]} {name}s" for name in ("result", "refusal", "time limit", "failure"))
    print(f"seed {options.seed}: {options.count} calls in {time.process_time() - begun:.0f} s of CPU: {names}")
    return int(tally.outcomes["failure"] > 0)


if __name__ == "__main__":
    sys.exit(main())
