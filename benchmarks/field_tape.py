"""Values and gradients of fields by the compiled tape and by NumPy: times for 100, 1000 and 100,000 points, and differences.

    python -m benchmarks.field_tape [--points 100 1000 100000] [--kinds gyroid blend]

NumPy evaluates the same recorded operations, one array operation for each, with its own sine and cosine and with SciPy's splines.
Columns: operations; for each number of points the nanoseconds a point of values and gradients by the tape, and how many times
longer NumPy takes; the greatest difference of values relative to the greatest value, and of gradients likewise.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.interpolate import CubicSpline, NdBSpline, PPoly

from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.blending import LinearCoordinate, SphereRadius
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.weights.line_weight import make_line_weight
from tpmscad.blending.weights.volume_weight import VolumeWeight
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.fields.kinds.volume_fraction_thresholds import GradedThreshold
from tpmscad.fields.tape.tape_nodes import Node, find_ancestors
from tpmscad.fields.tape.tape_program import list_operands, resolve_alias
from tpmscad.levelset.edge_rounding import ProfileMinMaxField, make_volume_neutral_profile
from tpmscad.splines import uniform_knots

LOW, HIGH = np.full(3, -2.0), np.full(3, 2.5)
REPEATS = 3

OPERATIONS: dict[str, Callable[..., Array]] = {
    "add": np.add,
    "subtract": np.subtract,
    "multiply": np.multiply,
    "divide": np.divide,
    "chain": lambda a, b: np.where(b == 0, 0.0, a * b),
    "at_least": lambda a, b: np.where(a >= b, 1.0, 0.0),
    "greater": lambda a, b: np.where(a > b, 1.0, 0.0),
    "select": lambda mask, a, b: np.where(mask != 0, a, b),
    "check": lambda a, mask: a,
    "absolute": np.abs,
    "root": np.sqrt,
    "tan": np.tan,
    "asin": np.arcsin,
    "acos": np.arccos,
    "atan": np.arctan,
    "sinh": np.sinh,
    "cosh": np.cosh,
    "tanh": np.tanh,
    "exp": np.exp,
    "log": np.log,
    "angle": np.arctan2,
}


def _apply(node: Node, operands: Sequence[Array]) -> Array:
    match node.name:
        case "scale":
            return node.numbers[0] * operands[0]
        case "shift":
            return operands[0] + node.numbers[0]
        case "sine_cosine":
            return np.cos(operands[0]) if node.output else np.sin(operands[0])
        case "power":
            return np.power(operands[0], node.numbers[0])
        case "piecewise":
            pieces, order = node.numbers[:2].astype(int)
            knots, coefficients = np.split(node.numbers[2:], [pieces + 1])
            finite = np.where(np.isfinite(knots), knots, knots[-2] + 1.0)
            return np.asarray(PPoly(coefficients.reshape(pieces, order).T, finite)(operands[0], node.output))
        case "tensor":
            head, coefficients = node.numbers.head, node.numbers.coefficients
            degrees, counts = head[:3].astype(int), head[3:6].astype(int)
            knots = np.split(head[6:], np.cumsum(degrees + counts + 1)[:2])
            order = [int(node.output == axis) for axis in (1, 2, 3)]
            spline = NdBSpline(tuple(knots), coefficients, tuple(degrees.tolist()))
            return np.asarray(spline(np.stack(operands, axis=-1), nu=order))
        case "periodic_spline":
            counts, rates = node.numbers.head[:3].astype(int), node.numbers.head[3:6]
            order = [int(node.output == axis) for axis in (1, 2, 3)]
            # in steps of the grid; the table begins with the last coefficient and ends with the first two
            table = np.pad(node.numbers.coefficients, (1, 2), mode="wrap")
            spline = NdBSpline(tuple(np.arange(-3.0, n + 4) for n in counts), table, (3, 3, 3))
            steps = [np.mod(t * rate, n) for t, rate, n in zip(operands, rates, counts, strict=True)]
            factor = np.prod(rates ** np.array(order))
            return np.asarray(factor * spline(np.stack(steps, axis=-1), nu=order))
    return OPERATIONS[node.name](*operands)


def evaluate_by_numpy(field: fields.Field, points: Array) -> tuple[Array, Array]:
    """Values (n,) and gradients (n, 3) of a field at points (n, 3) by NumPy, operation by operation."""
    evaluator = field.tape.evaluator(True)
    columns = np.ascontiguousarray(points.T)
    order = find_ancestors(evaluator.outputs, (), partial(list_operands, guarded=False))
    found: dict[int, Array] = {}
    inputs = evaluator.read_inputs(columns)
    with np.errstate(all="ignore"):
        for node in order:
            if node.name == "coordinate":
                found[node.index] = columns[node.numbers[0]]
            elif node.name == "constant":
                found[node.index] = np.array(node.numbers[0])
            elif node.name == "input":
                found[node.index] = inputs[evaluator.inputs.index(node)]
            else:
                found[node.index] = _apply(node, [found[resolve_alias(arg).index] for arg in node.args])
    value, *gradient = (np.broadcast_to(found[node.index], len(points)) for node in evaluator.outputs)
    return value, np.stack(gradient, axis=-1)


def make_kinds() -> dict[str, fields.Field]:
    """A field of every kind that the tape holds, in the box from LOW to HIGH."""
    rng = np.random.default_rng(5)
    gyroid, ball = fields.tpms("gyroid", 1.7), fields.sphere((0.1, 0.2, 0.3), 1.3)
    rod, sheet = fields.rod(fields.tpms("schwarz_p", 2.0), -0.2), fields.sheet(gyroid, -0.3, 0.4)
    rounded = ProfileMinMaxField(-0.3 - gyroid, gyroid - 0.4, 1, 0.3, make_volume_neutral_profile())
    left, right, middle = (fields.box((a, -9, -9), (b, 9, 9)) for a, b in ((-9, 0), (0, 9), (-1, 1)))
    domain = ((-2.0,) * 3, (2.5,) * 3)
    line = make_line_weight(LinearCoordinate(), (-1.0, 1.0), (-2.0, 2.5))
    line = line.with_coefficients(np.where(line.is_free, rng.random(len(line.coefficients)), line.coefficients))
    knots = tuple(uniform_knots(6, 3, domain=(-2.0, 2.5)) for _ in range(3))
    volume = VolumeWeight(rng.random((9, 9, 9)), knots, (3, 3, 3), np.ones((9, 9, 9), bool))  # type: ignore[arg-type]
    blend = BlendedField((rod, rounded), (left, right), (middle,), (line,), (), domain)  # type: ignore[arg-type]
    threshold = GradedThreshold(
        fields.ramp("x", (-2, 2), (0.25, 0.45)), CubicSpline([0.2, 0.3, 0.4, 0.5], [-0.85, -0.6, -0.3, 0.0]), 0.0, 1.0
    )
    shell = fields.difference(fields.sphere((0, 0, 0), 2.0), fields.sphere((0, 0, 0), 1.0))
    radial = make_line_weight(SphereRadius(), (1.0, 2.0), (0.0, 7.0))
    return {
        "gyroid": gyroid,
        "octo": fields.tpms("octo", 1.7),
        "sheet": sheet,
        "graded sheet": fields.sheet(gyroid, -0.3, fields.ramp("x", (-1, 2), (0.1, 0.5))),
        "graded threshold": fields.rod(gyroid, threshold),
        "cell sizes": fields.cell_sizes(gyroid, x=((-1, 0.5, 2), (1.7, 1.7, 1.2))),
        "box": fields.box((0, -1, 0.5), (2, 1, 3)),
        "sphere": ball,
        "half-space": fields.halfspace((1, 0, 0.5), (1, 2, 3)),
        "cylinder": fields.cylinder((0.1, 0.2, 0.3), 0.8, (1, 1, 0.3), 1.4),
        "union": gyroid | ball,
        "smooth union": fields.smooth_union(gyroid, ball, 0.7),
        "rounded sheet": rounded,
        "rotated": fields.rotate(sheet, (1, 2, 3), 31, (1, 0, 0)),
        "formula": fields.expression("sin(2*x)*exp(y/4) + atan2(y + 9, x^2 + 1) / (2 + cos(z))^2", 5.0),
        "blend": blend,
        "blend of volume weight": replace(blend, weights=(volume,)),
        "blend round a sphere": BlendedField((rod, sheet), (ball, -ball), (shell,), (radial,)),
        "extended blend": extend_linearly(blend, LOW, HIGH),
        "B-spline unit": fields.bspline_unit(rng.normal(size=(5, 4, 6)), (1.3, 1.7, 2.1)),
        "image and gyroid": gyroid & fields.image_region(rng.random((6, 5, 4)) > 0.5, (-2, -2, -2), (2.5, 2.5, 2.5)),
    }


def compare(field: fields.Field, points: Array) -> tuple[float, float]:
    """Greatest differences of values and of gradients between tape and NumPy, relative to the greatest of each."""
    (value, gradient), (expected, slope) = field.value_and_gradient(points), evaluate_by_numpy(field, points)
    return (
        float(np.abs(value - expected).max() / np.abs(expected).max()),
        float(np.abs(gradient - slope).max() / np.abs(slope).max()),
    )


def _seconds(call: Callable[[], object], n: int) -> float:
    """Least CPU time of a call in several runs."""
    call()
    repeats, times = max(1, 20_000 // n), []
    for _ in range(REPEATS):
        start = time.process_time()
        for _ in range(repeats):
            call()
        times.append((time.process_time() - start) / repeats)
    return min(times)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--points", type=int, nargs="+", default=[100, 1000, 100_000])
    parser.add_argument("--kinds", nargs="+")
    arguments = parser.parse_args()
    rng = np.random.default_rng(0)
    print("| field | operations |", *(f"{n} points, ns (NumPy) |" for n in arguments.points), "values | gradients |")
    print("|---|---|", *("---|" for _ in arguments.points), "---|---|")
    for name, field in make_kinds().items():
        if arguments.kinds and name not in arguments.kinds:
            continue
        cells = []
        for n in arguments.points:
            points = rng.uniform(LOW, HIGH, (n, 3))
            tape = _seconds(partial(field.value_and_gradient, points), n)
            by_numpy = _seconds(partial(evaluate_by_numpy, field, points), n)
            cells.append(f"{1e9 * tape / n:.0f} ({by_numpy / tape:.1f} x) |")
        differences = compare(field, rng.uniform(LOW - 0.5, HIGH + 0.5, (20_000, 3)))
        n_operations = len(field.tape.evaluator(True).nodes)
        print(f"| {name} | {n_operations} |", *cells, *(f"{d:.1e} |" for d in differences), flush=True)


if __name__ == "__main__":
    main()
