"""A field's tape: its formula recorded once, compiled for points and for grids, for values and for gradients.

On a grid, whatever depends on one coordinate only is evaluated once for each plane, by a program of its own. Programs of points
and of grids run the same operations in the same order, so that both give the same bits.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from threading import Lock
from typing import Any, Protocol

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.tape.tape_derivatives import differentiate
from tpmscad.fields.tape.tape_interpreter import BLOCK, LOAD_POINT, LOAD_X, LOAD_Z, run_tape
from tpmscad.fields.tape.tape_nodes import Node, Recorder, find_ancestors, is_mask, resolve_alias
from tpmscad.fields.tape.tape_program import Program, Source, compile_program, list_operands

MIN_LANE = 16
"""Planes along z below which a grid is evaluated as points: its lines would leave most of a block empty."""

MAX_POINTS_PER_CALL = 1 << 16
"""Points at which foreign functions are evaluated at a time: half a megabyte per intermediate array."""

NO_TABLE = np.zeros((0, 1))

Axes = tuple[Array, Array, Array]


class Traced(Protocol):
    """An object whose values are a formula on the nodes of a tape."""

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula at coordinates."""
        ...


class FieldTape:
    """The tape of one field. Values have the shape (n,), jets (4, n): value and three derivatives."""

    def __init__(self, source: Traced) -> None:
        self.recorder = Recorder()
        self.value = source.trace(*self.recorder.coordinates)
        self._evaluators: dict[bool, _Evaluator] = {}
        self._lock = Lock()

    @property
    def calls_foreign_functions(self) -> bool:
        """Whether the formula needs functions that are evaluated outside the tape."""
        return bool(self.evaluator(False).externals)

    def values_at(self, points: Array) -> Array:
        """Values (n,) at points (n, 3)."""
        return self._evaluate(points, False)[0]

    def jets_at(self, points: Array) -> tuple[Array, Array]:
        """Values (n,) and gradients (n, 3) at points (n, 3)."""
        jets = self._evaluate(points, True)
        return jets[0], np.ascontiguousarray(jets[1:].T)

    def values_on_grid(self, axes: Axes) -> Array | None:
        """Values (nx, ny, nz) on a grid in one pass; None where foreign functions need intermediate arrays."""
        evaluator = self.evaluator(False)
        if evaluator.externals or len(axes[2]) < MIN_LANE:
            return None
        return np.asarray(evaluator.on_grid(axes)[0])

    def _evaluate(self, points: Array, with_gradient: bool) -> Array:
        """Outputs (m, n) at points (n, 3), in batches if foreign functions are called."""
        evaluator, columns = self.evaluator(with_gradient), np.ascontiguousarray(points.T)
        if not evaluator.externals or len(points) <= MAX_POINTS_PER_CALL:
            return evaluator.at_points(columns)
        starts = range(0, len(points), MAX_POINTS_PER_CALL)
        return np.hstack([evaluator.at_points(columns[:, i : i + MAX_POINTS_PER_CALL].copy()) for i in starts])

    def evaluator(self, with_gradient: bool) -> _Evaluator:
        """The evaluator of values, or of values and gradients."""
        with self._lock:  # threads may evaluate one field, and recording is in steps
            if with_gradient not in self._evaluators:
                outputs = _make_jet(self.value) if with_gradient else [self.value]
                self._evaluators[with_gradient] = _Evaluator(self.recorder, outputs)
            return self._evaluators[with_gradient]


class SharedTape:
    """The tape of several fields: what their formulas have in common, foreign functions included, is evaluated once."""

    def __init__(self, sources: Sequence[Traced]) -> None:
        recorder = Recorder()
        values = [source.trace(*recorder.coordinates) for source in sources]
        self._evaluator = _Evaluator(recorder, [node for value in values for node in _make_jet(value)])

    def jets_on_grid(self, x: Array, y: Array, z: Array) -> Iterator[tuple[Array, Array]]:
        """Values (nx, ny, nz) and gradients (nx, ny, nz, 3) of each field on the grid of the axes."""
        jets = self._evaluator.on_grid((x, y, z))
        for first in range(0, len(jets), 4):
            yield jets[first], np.moveaxis(jets[first + 1 : first + 4], 0, -1)


def _make_jet(value: Node) -> list[Node]:
    """A formula and its derivatives by the coordinates."""
    recorder = value.recorder
    zero = recorder.constant(0.0)
    return [value, *(zero if p is None else p for p in differentiate(value, recorder.coordinates))]


@dataclass(frozen=True, slots=True)
class _ForeignCall:
    """A foreign function, the rows of its coordinates, and the row of the mask of the points at which it is needed, if any."""

    external: int
    coordinates: list[int]
    mask: int | None


def _split_into_blocks(count: int, masks: Array | None = None) -> IntArray:
    """Ends of the blocks of `count` columns; a mask (m, count), if given, is constant in each unless it changes all the time.

    What a mask guards is then run for the columns that need it only, such as a field's extension beyond the faces of a box.
    """
    changes: list[int] = []
    if masks is not None:
        found = np.flatnonzero((masks[:, 1:] != masks[:, :-1]).any(axis=0)) + 1
        changes = found.tolist() if len(found) * MIN_LANE <= count else []
    parts = itertools.pairwise([0, *changes, count])
    return np.array([*(at for low, high in parts for at in range(low, high, BLOCK)), count], np.int64)


class _Evaluator:
    """Programs of the same outputs for points and for grids, compiled when they are needed."""

    def __init__(self, recorder: Recorder, outputs: Sequence[Node], guarded: bool = True) -> None:
        self.recorder, self.outputs, self.guarded = recorder, [resolve_alias(node) for node in outputs], guarded
        self.nodes = find_ancestors(self.outputs, (), partial(list_operands, guarded=guarded))
        self.inputs = [node for node in self.nodes if node.name == "input"]
        self.loads: dict[int, Source] = {node.index: (LOAD_POINT, k) for k, node in enumerate(self.inputs)}
        self.externals = sorted({node.numbers[0] for node in self.inputs})
        self.rows_of = {k: [r for r, node in enumerate(self.inputs) if node.numbers[0] == k] for k in self.externals}
        self.needs_jet = {node.numbers[0] for node in self.inputs if node.output}

    def at_points(self, columns: Array) -> Array:
        """Outputs (m, n) at points given as columns (3, n)."""
        ends = _split_into_blocks(columns.shape[1])
        return self._run(self._point_program, (NO_TABLE, NO_TABLE, columns), ends, self.read_inputs(columns), columns)

    def read_inputs(self, columns: Array) -> Array:
        """Values and derivatives (inputs, n) of the foreign functions at points given as columns (3, n)."""
        inputs = np.empty((len(self.inputs), columns.shape[1]))
        for evaluator, calls in self._foreign_calls:
            found = columns if evaluator is None else np.concatenate([columns, evaluator.at_points(columns)])
            for call in calls:
                is_needed = None if call.mask is None else found[call.mask] != 0
                self._fill(inputs, call.external, [found[row] for row in call.coordinates], is_needed)
        return inputs

    @cached_property
    def _point_program(self) -> Program:
        loads = {node.index: (LOAD_Z, axis) for axis, node in enumerate(self.recorder.coordinates)}
        return compile_program(self.outputs, self.loads | loads, self.guarded)

    @cached_property
    def _foreign_calls(self) -> list[tuple[_Evaluator | None, list[_ForeignCall]]]:
        """Calls of foreign functions, and the evaluators of what they need: all together unless one needs another's result."""
        waiting = {k: self.recorder.externals[k] for k in self.externals}
        plan: list[tuple[_Evaluator | None, list[_ForeignCall]]] = []
        while waiting:
            outputs: dict[Node, int] = {node: axis for axis, node in enumerate(self.recorder.coordinates)}
            calls = []
            for k, each in waiting.items():
                nodes = each.coordinates if each.mask is None else (*each.coordinates, resolve_alias(each.mask))
                ancestors = find_ancestors(nodes, (), partial(list_operands, guarded=self.guarded))
                if waiting.keys() & {node.numbers[0] for node in ancestors if node.name == "input"}:
                    continue
                rows = [outputs.setdefault(node, len(outputs)) for node in nodes]
                calls.append(_ForeignCall(k, rows[:3], None if each.mask is None else rows[3]))
            own = list(outputs)[3:]
            plan.append((_Evaluator(self.recorder, own, self.guarded) if own else None, calls))
            for call in calls:
                del waiting[call.external]
        return plan

    def on_grid(self, axes: Axes) -> Array:
        """Outputs (m, nx, ny, nz) on a grid."""
        shape = tuple(len(axis) for axis in axes)
        if shape[2] < MIN_LANE and not self.externals:
            columns = np.stack([c.ravel() for c in np.meshgrid(*axes, indexing="ij")])
            return self.at_points(columns).reshape(-1, *shape)
        program, of_axis = self._grid_program
        tables = []
        for k, (axis, evaluator) in enumerate(zip(axes, of_axis, strict=True)):
            table = axis[None]
            if evaluator is not None:
                columns = np.zeros((3, len(axis)))
                columns[k] = axis
                table = np.concatenate([table, evaluator.at_points(columns)])
            tables.append(table)
        inputs = np.empty((len(self.inputs), int(np.prod(shape))))
        for k in self.externals:
            mask = self._mask_evaluators[k]
            is_needed = None if mask is None else mask.on_grid(axes)[0].ravel() != 0
            self._fill(inputs, k, self._map_grid(k, axes), is_needed)
        along_z = [] if of_axis[2] is None else of_axis[2].outputs
        masks = tables[2][[k + 1 for k, node in enumerate(along_z) if is_mask(node)]]
        ends = _split_into_blocks(shape[2], masks)
        return self._run(program, (tables[0], tables[1], tables[2]), ends, inputs, axes).reshape(-1, *shape)

    @cached_property
    def _grid_program(self) -> tuple[Program, list[_Evaluator | None]]:
        """The program of grids, and for each axis the evaluator of what depends on its coordinate only."""
        loads = dict(self.loads)
        evaluators: list[_Evaluator | None] = []
        used = {each.index for node in self.nodes if node.depends not in (1, 2, 4) for each in list_operands(node)}
        used |= {node.index for node in self.outputs}
        for axis, coordinate in enumerate(self.recorder.coordinates):
            loads[coordinate.index] = LOAD_X + axis, 0
            hoisted = [
                node
                for node in self.nodes
                if node.depends == 1 << axis and node.index in used and node is not coordinate and node.name != "alias"
            ]
            # without guards: their masks may depend on the other coordinates
            evaluators.append(_Evaluator(self.recorder, hoisted, guarded=False) if hoisted else None)
            loads |= {node.index: (LOAD_X + axis, k + 1) for k, node in enumerate(hoisted)}
        return compile_program(self.outputs, loads), evaluators

    def _run(self, program: Program, tables: Axes, ends: IntArray, inputs: Array, coordinates: Any) -> Array:
        found = np.empty((len(self.outputs), tables[0].shape[1] * tables[1].shape[1] * tables[2].shape[1]))
        coefficients = program.tables if len(program.tables) else None
        place, point = run_tape(
            program.code, program.parameters, coefficients, program.n_rows, *tables, ends, inputs, found
        )
        if place >= 0:
            shape = [len(axis) for axis in coordinates] if isinstance(coordinates, tuple) else None
            at = (point, point, point) if shape is None else np.unravel_index(point, shape)
            x, y, z = (float(t[k]) for t, k in zip(coordinates, at, strict=True))
            raise self.recorder.errors[program.errors[place]](float(found[0, point]), (x, y, z))
        return found

    @cached_property
    def _coordinate_evaluators(self) -> dict[int, _Evaluator | None]:
        """The evaluators of the coordinates of foreign functions; None for those of the points."""
        calls = {k: self.recorder.externals[k].coordinates for k in self.externals}
        own = self.recorder.coordinates
        return {k: None if nodes == own else _Evaluator(self.recorder, nodes) for k, nodes in calls.items()}

    @cached_property
    def _mask_evaluators(self) -> dict[int, _Evaluator | None]:
        """The evaluators of the masks of foreign functions; None for a function that is needed at all points."""
        masks = {k: self.recorder.externals[k].mask for k in self.externals}
        return {k: None if mask is None else _Evaluator(self.recorder, [mask]) for k, mask in masks.items()}

    def _map_grid(self, external: int, axes: Axes) -> list[Array]:
        """Coordinates of a foreign function on a grid; those of a grid again if each depends on its own axis only."""
        own = self._coordinate_evaluators[external]
        parts = list(axes)
        if own is not None:
            if any(node.depends & ~(1 << axis) for axis, node in enumerate(own.outputs)):
                return list(own.on_grid(axes))
            for k, axis in enumerate(axes):
                columns = np.zeros((3, len(axis)))
                columns[k] = axis
                parts[k] = own.at_points(columns)[k]
        return [parts[0][:, None, None], parts[1][None, :, None], parts[2][None, None, :]]

    def _fill(self, inputs: Array, external: int, coordinates: Sequence[Any], is_needed: BoolArray | None) -> None:
        """Write the value, or value and derivatives, of a foreign function into its rows of the inputs; 0 where not needed."""
        source, rows = self.recorder.externals[external].source, self.rows_of[external]
        columns: slice | BoolArray = slice(None)
        if is_needed is not None and not is_needed.all():
            inputs[rows] = 0.0
            if not is_needed.any():
                return
            coordinates, columns = [c.ravel()[is_needed] for c in np.broadcast_arrays(*coordinates)], is_needed
        results = source.jet(*coordinates) if external in self.needs_jet else (source.at(*coordinates),)
        shape = np.broadcast_shapes(*(c.shape for c in coordinates))
        for row in rows:
            inputs[row, columns] = np.broadcast_to(results[self.inputs[row].output], shape).ravel()
