"""Programs of tapes: recorded nodes in the order of execution, with rows assigned to them, as arrays for the interpreter."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.fields.tape.tape_interpreter import CODES
from tpmscad.fields.tape.tape_nodes import (
    MaskedBlock,
    Node,
    SplineNumbers,
    find_ancestors,
    list_enclosing,
    resolve_alias,
)
from tpmscad.splines.basis import span_polynomials

MAX_OUTPUTS, MAX_OPERANDS = 4, 3
PLACE = 1 + MAX_OUTPUTS + MAX_OPERANDS
"""The column of the place of an operation's parameters, after its code, results and operands; that of its mask follows."""

OPERATIONS_OF_SEVERAL_RESULTS = ("sine_cosine", "piecewise", "tensor", "periodic_spline")
RESULTS_WRITTEN = {"sine_cosine": 2}
"""Results that an operation writes, wanted or not."""

Source = tuple[int, int]
"""Where a loaded node comes from: the table (`tape_interpreter.LOAD_X`, ...) and its row."""


@dataclass(frozen=True, slots=True, eq=False)
class Program:
    """Operations (m, 10), their parameters and tables, the number of rows, and the error of each check by its parameters."""

    code: IntArray
    parameters: Array
    tables: Array
    n_rows: int
    errors: Mapping[int, int]


@dataclass(slots=True, eq=False)
class _Step:
    """An operation with one or more results, and the masked block in which it runs."""

    node: Node
    results: dict[int, Node]
    block: MaskedBlock | None
    operands: list[Node]


def compile_program(outputs: Sequence[Node], loads: Mapping[int, Source], guarded: bool = True) -> Program:
    """The program that computes the outputs, with the nodes in `loads` (by index) read from tables.

    Without guards all operations run in every block.
    """
    outputs = [resolve_alias(node) for node in outputs]
    nodes = find_ancestors(outputs, loads, partial(list_operands, guarded=guarded))
    steps = [_Step(node, {0: node}, None, []) for node in nodes if node.index in loads]
    steps += _group_results([n for n in nodes if n.name != "constant" and n.index not in loads], guarded)
    last_use = {operand.index: at for at, step in enumerate(steps) for operand in step.operands}
    last_use |= {node.index: len(steps) for node in (*outputs, *nodes) if node in outputs or node.name == "constant"}
    writer = _Writer()
    for node in nodes:
        if node.name == "constant":
            writer.write("constant", [writer.take_row(node)], [], node.numbers)
    block: MaskedBlock | None = None
    for at, step in enumerate(steps):
        if step.block is not block:
            block = step.block
            writer.guard(block)
        writer.write_step(step, loads)
        for node in (*step.operands, *step.results.values()):
            if last_use.get(node.index, at) == at:
                writer.release_row(node)
    writer.guard(None)
    for k, node in enumerate(outputs):
        writer.write("output", [k], [writer.row_of[node.index]], ())
    return writer.finish()


def list_operands(node: Node, guarded: bool = True) -> list[Node]:
    """The nodes whose values an operation needs, with guards the masks of its masked blocks included."""
    found = [resolve_alias(arg) for arg in node.args]
    masks = [each.mask for each in list_enclosing(node.block)] if guarded else []
    return [*found, *map(resolve_alias, masks)]


def _group_results(nodes: Sequence[Node], guarded: bool) -> list[_Step]:
    """Steps in order, with the results of one operation together."""
    steps: list[_Step] = []
    known: dict[tuple[object, int], _Step] = {}
    for node in nodes:
        key = node.operation, id(node.block)
        if node.name in OPERATIONS_OF_SEVERAL_RESULTS and key in known:
            known[key].results[node.output] = node
            continue
        block = node.block if guarded else None
        known[key] = _Step(node, {node.output: node}, block, list_operands(node, guarded))
        steps.append(known[key])
    return steps


def _lay_out_tensor(head: Array, coefficients: Array) -> tuple[Array, Array]:
    """The degrees, numbers of coefficients and knots, and the table of a spline, in the layout that the interpreter reads."""
    degrees, counts = head[:3].astype(int), head[3:6].astype(int)
    knots = np.split(head[6:], np.cumsum(degrees + counts + 1)[:2])
    orders = 4 * np.ceil((degrees + 1) / 4).astype(int)
    spare = orders - degrees - 1
    axes = []
    for t, degree, zeros in zip(knots, degrees.tolist(), spare.tolist(), strict=True):
        ends, polynomials = span_polynomials(t, degree)
        spans = len(polynomials)
        table = np.pad(np.swapaxes(polynomials, 1, 2), ((0, 0), (zeros, 0), (0, zeros)))
        axes += [[spans], ends, [spans / (ends[-1] - ends[0])], table.ravel()]
    table = np.pad(coefficients, [(0, zeros) for zeros in spare]) if spare.any() else coefficients
    return np.concatenate([orders, table.shape, *axes]), table


class _Writer:
    """Operations as they are written, the rows in use, and the guards that are open."""

    def __init__(self) -> None:
        self.code: list[list[int]] = []
        self.parameters: list[Array] = [np.zeros(1)]
        self.n_parameters = 1
        self.tables: list[Array] = []
        self.n_rows = 0
        self.free: list[int] = []
        self.row_of: dict[int, int] = {}
        self.guards: list[int] = []
        self.errors: dict[int, int] = {}

    def take_row(self, node: Node) -> int:
        """A row for a node."""
        if not self.free:
            self.free.append(self.n_rows)
            self.n_rows += 1
        self.row_of[node.index] = self.free.pop()
        return self.row_of[node.index]

    def release_row(self, node: Node) -> None:
        """Make the row of a node free."""
        if node.index in self.row_of:
            self.free.append(self.row_of.pop(node.index))

    def write(
        self, name: str, results: Sequence[int], operands: Sequence[int], numbers: object, mask_row: int = -1
    ) -> None:
        """Append an operation with its parameters, and the row of the mask of the columns that need it, -1 for all."""
        place = 0
        array = np.atleast_1d(np.asarray(numbers, float))
        if len(array):
            place = self.n_parameters
            self.parameters.append(array)
            self.n_parameters += len(array)
        padded = [*results, *[-1] * (MAX_OUTPUTS - len(results)), *operands, *[-1] * (MAX_OPERANDS - len(operands))]
        self.code.append([CODES[name], *padded, place, mask_row])

    def write_step(self, step: _Step, loads: Mapping[int, Source]) -> None:
        """Append a step."""
        node = step.node
        if node.index in loads:
            table, row = loads[node.index]
            self.write("load", [self.take_row(node)], [row, table], ())
            return
        operands = [self.row_of[resolve_alias(arg).index] for arg in node.args]
        results = [self.take_row(step.results[k]) if k in step.results else -1 for k in range(MAX_OUTPUTS)]
        spare = [k for k in range(RESULTS_WRITTEN.get(node.name, 0)) if results[k] < 0]
        for k in spare:
            results[k] = self.n_rows
            self.n_rows += 1
        numbers = self.lay_out_spline(node) if isinstance(node.numbers, SplineNumbers) else node.numbers
        mask_row = -1 if step.block is None else self.mask_row(step.block)
        self.write(node.name, results, operands, numbers, mask_row)
        self.free += [results[k] for k in spare]
        if node.name == "check":
            self.errors[self.code[-1][PLACE]] = int(node.numbers[2])

    def lay_out_spline(self, node: Node) -> Array:
        """The parameters of a spline, whose table is appended to those of the program."""
        head, table = node.numbers.head, node.numbers.coefficients
        if node.name == "tensor":
            head, table = _lay_out_tensor(head, table)
        else:
            table = np.pad(table, (1, 2), mode="wrap")
        place = sum(each.size for each in self.tables)
        self.tables.append(table.reshape(-1))
        return np.concatenate([[place], head])

    def mask_row(self, block: MaskedBlock) -> int:
        """The row of a masked block's mask."""
        return self.row_of[resolve_alias(block.mask).index]

    def guard(self, block: MaskedBlock | None) -> None:
        """End the guards that are open, and open those of a masked block, the outermost first."""
        for at in self.guards:
            self.code[at][6] = len(self.code)
        self.guards = []
        for each in reversed(list_enclosing(block)):
            self.guards.append(len(self.code))
            self.write("guard", [], [self.mask_row(each), 0], ())

    def finish(self) -> Program:
        """The program written."""
        code = np.array(self.code, np.int64).reshape(-1, PLACE + 2)
        tables = self.tables[0] if len(self.tables) == 1 else np.concatenate([np.zeros(0), *self.tables])
        writable = tables if tables.flags.writeable else tables.copy()  # compiled loops tell arrays apart by it
        return Program(code, np.concatenate(self.parameters), writable, self.n_rows, self.errors)
