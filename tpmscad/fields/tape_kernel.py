"""The compiled interpreter of tapes: elementary operations on blocks of points, one loop for each operation.

A tape is a list of operations on rows of numbers, one row for each intermediate value and one column for each point of a block.
Every loop is elementwise, so that a point has the same bits in every block. Sine and cosine are computed together, by argument
reduction (Cody and Waite) and the polynomials of fdlibm, which the compiler turns into vector instructions.
"""

from __future__ import annotations

import math

import numpy as np

from tpmscad._compiled_loops import njit_cached

BLOCK = 128
"""Points of a block: a row is one kilobyte, so that the rows of a field stay in the cache, and the loops are long enough."""

OPERATIONS = (
    *("load", "constant", "output", "guard", "check"),
    *("scale", "shift", "add", "subtract", "multiply", "divide", "chain"),
    *("at_least", "greater", "select"),
    *("absolute", "root", "sine_cosine", "piecewise", "tensor"),
    *("tan", "asin", "acos", "atan", "sinh", "cosh", "tanh", "exp", "log", "power", "angle"),
    "periodic_spline",
)
"""Names of the operations; their codes are the positions."""

CODES = {name: code for code, name in enumerate(OPERATIONS)}

LOAD_X, LOAD_Y, LOAD_Z, LOAD_POINT = range(4)
"""Where a loaded row comes from: a table over the x, y or z axis of the grid, or one over all its points."""

REDUCTION_LIMIT = 1e6
"""Angle, radians, beyond which sine and cosine are those of the C library."""

_TWO_OVER_PI = 2 / math.pi
_HALF_PI_1, _HALF_PI_2, _HALF_PI_3 = 1.57079632673412561417e00, 6.07710050630396597660e-11, 2.02226624871116645580e-21
_ROUND = 6755399441055744.0  # 1.5 * 2**52: adding and subtracting it rounds to the nearest integer
_S1, _S2, _S3 = -1.66666666666666324348e-01, 8.33333333332248946124e-03, -1.98412698298579493134e-04
_S4, _S5, _S6 = 2.75573137070700676789e-06, -2.50507602534068634195e-08, 1.58969099521155010221e-10
_C1, _C2, _C3 = 4.16666666666666019037e-02, -1.38888888888741095749e-03, 2.48015872894767294178e-05
_C4, _C5, _C6 = -2.75573143513906633035e-07, 2.08757232129817482790e-09, -1.13596475577881948265e-11

_LOAD, _CONSTANT, _OUTPUT, _GUARD, _CHECK = range(5)
_SCALE, _SHIFT, _ADD, _SUBTRACT, _MULTIPLY, _DIVIDE, _CHAIN = range(5, 12)
_AT_LEAST, _GREATER, _SELECT = range(12, 15)
_ABSOLUTE, _ROOT, _SINE_COSINE, _PIECEWISE, _TENSOR = range(15, 20)
_TAN, _ASIN, _ACOS, _ATAN, _SINH, _COSH, _TANH, _EXP, _LOG, _POWER, _ANGLE = range(20, 31)
_PERIODIC_SPLINE = 31


@njit_cached
def _sine_cosine(angle):  # type: ignore[no-untyped-def]  # pragma: no cover
    turns = (angle * _TWO_OVER_PI + _ROUND) - _ROUND
    r = ((angle - turns * _HALF_PI_1) - turns * _HALF_PI_2) - turns * _HALF_PI_3
    s = r * r
    sine = r + (r * s) * (_S1 + s * (_S2 + s * (_S3 + s * (_S4 + s * (_S5 + s * _S6)))))
    cosine = 1.0 - (0.5 * s - (s * s) * (_C1 + s * (_C2 + s * (_C3 + s * (_C4 + s * (_C5 + s * _C6))))))
    quarter = turns - 4.0 * np.floor(0.25 * turns)
    odd = (quarter == 1.0) | (quarter == 3.0)
    first = cosine if odd else sine
    second = sine if odd else cosine
    first = -first if quarter >= 2.0 else first
    second = -second if (quarter == 1.0) | (quarter == 2.0) else second
    return first, second


@njit_cached
def _piecewise(rows, n, value, slope, argument, p, parameters):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Piecewise polynomials: parameters are the numbers of pieces and coefficients, the knots, and rows of coefficients."""
    pieces, terms = int(parameters[p]), int(parameters[p + 1])
    knots, first = p + 2, p + 3 + pieces
    for i in range(n):
        t = rows[argument, i]
        low, high = 0, pieces
        while high - low > 1:
            middle = (low + high) >> 1
            if t >= parameters[knots + middle]:
                low = middle
            else:
                high = middle
        t -= parameters[knots + low]
        at = first + low * terms
        total, rate = parameters[at], 0.0
        for k in range(1, terms):
            rate = rate * t + total
            total = total * t + parameters[at + k]
        if value >= 0:
            rows[value, i] = total
        if slope >= 0:
            rows[slope, i] = rate


@njit_cached
def _basis(t, p, degree, count, parameters, values, slopes):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The index of the first of the degree + 1 B-splines that are not zero at t, their values and slopes; knots start at p."""
    low, high = degree, count
    while high - low > 1:
        middle = (low + high) >> 1
        if t >= parameters[p + middle]:
            low = middle
        else:
            high = middle
    values[0] = 1.0
    for d in range(1, degree + 1):
        if d == degree:
            for j in range(degree):
                slopes[j] = values[j]
        saved = 0.0
        for j in range(d):
            right, left = parameters[p + low + j + 1], parameters[p + low + 1 - d + j]
            part = values[j] / (right - left)
            values[j] = saved + (right - t) * part
            saved = (t - left) * part
        values[d] = saved
    before = 0.0
    for j in range(degree):
        rate = degree * slopes[j] / (parameters[p + low + j + 1] - parameters[p + low + 1 - degree + j])
        slopes[j] = before - rate
        before = rate
    slopes[degree] = before
    return low - degree


@njit_cached
def _tensor(rows, n, op, p, parameters):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Tensor-product splines: parameters are the degrees, the numbers of coefficients, the knots, and the coefficients."""
    value, dx, dy, dz = op[1], op[2], op[3], op[4]
    degree = (int(parameters[p]), int(parameters[p + 1]), int(parameters[p + 2]))
    count = (int(parameters[p + 3]), int(parameters[p + 4]), int(parameters[p + 5]))
    kx = p + 6
    ky = kx + count[0] + degree[0] + 1
    kz = ky + count[1] + degree[1] + 1
    table = kz + count[2] + degree[2] + 1
    a, b, c = np.empty(degree[0] + 1), np.empty(degree[1] + 1), np.empty(degree[2] + 1)
    da, db, dc = np.empty(degree[0] + 1), np.empty(degree[1] + 1), np.empty(degree[2] + 1)
    only_value = dx < 0 and dy < 0 and dz < 0
    for i in range(n):
        first_x = _basis(rows[op[5], i], kx, degree[0], count[0], parameters, a, da)
        first_y = _basis(rows[op[6], i], ky, degree[1], count[1], parameters, b, db)
        first_z = _basis(rows[op[7], i], kz, degree[2], count[2], parameters, c, dc)
        total = total_x = total_y = total_z = 0.0
        for u in range(degree[0] + 1):
            plane = plane_y = plane_z = 0.0
            for v in range(degree[1] + 1):
                at = table + ((first_x + u) * count[1] + first_y + v) * count[2] + first_z
                line = line_z = 0.0
                for w in range(degree[2] + 1):
                    line += c[w] * parameters[at + w]
                plane += b[v] * line
                if not only_value:
                    for w in range(degree[2] + 1):
                        line_z += dc[w] * parameters[at + w]
                    plane_y += db[v] * line
                    plane_z += b[v] * line_z
            total += a[u] * plane
            total_x += da[u] * plane
            total_y += a[u] * plane_y
            total_z += a[u] * plane_z
        for row, found in ((value, total), (dx, total_x), (dy, total_y), (dz, total_z)):
            if row >= 0:
                rows[row, i] = found


@njit_cached
def _cardinal_splines(t, count, rate, values, slopes):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The four cubic cardinal B-splines of a periodic grid that are not zero at t, values and slopes; the interval of t."""
    u = t * rate
    base = math.floor(u)
    r = u - base
    s = 1.0 - r
    values[0], values[1] = (s * s * s) / 6.0, (4.0 + (r * r) * (3.0 * r - 6.0)) / 6.0
    values[2], values[3] = (4.0 + (s * s) * (3.0 * s - 6.0)) / 6.0, (r * r * r) / 6.0
    slopes[0], slopes[1] = (-0.5 * rate) * (s * s), (0.5 * rate) * (r * (3.0 * r - 4.0))
    slopes[2], slopes[3] = (-0.5 * rate) * (s * (3.0 * s - 4.0)), (0.5 * rate) * (r * r)
    return int(base - count * math.floor(base / count)) % count


@njit_cached
def _periodic_spline(rows, n, op, p, parameters):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Cubic splines on periodic grids; parameters: the numbers of coefficients, the same per unit of length, a table of them.

    The table goes on for three coefficients beyond the period along each axis, so that those of an interval are consecutive.
    """
    value, dx, dy, dz = op[1], op[2], op[3], op[4]
    counts = (int(parameters[p]), int(parameters[p + 1]), int(parameters[p + 2]))
    height, depth = counts[1] + 3, counts[2] + 3
    weights, slopes, first = np.empty((3, 4)), np.empty((3, 4)), np.empty(3, np.int64)
    only_value = dx < 0 and dy < 0 and dz < 0
    for i in range(n):
        finite = True
        for axis in range(3):
            t = rows[op[5 + axis], i]
            finite &= math.isfinite(t)
            t = t if math.isfinite(t) else 0.0
            first[axis] = _cardinal_splines(t, counts[axis], parameters[p + 3 + axis], weights[axis], slopes[axis])
        start = p + 6 + (first[0] * height + first[1]) * depth + first[2]
        c0, c1, c2, c3 = weights[2]
        d0, d1, d2, d3 = slopes[2]
        total = total_x = total_y = total_z = 0.0
        for u in range(4):
            plane = plane_y = plane_z = 0.0
            for v in range(4):
                at = start + (u * height + v) * depth
                f0, f1, f2, f3 = parameters[at], parameters[at + 1], parameters[at + 2], parameters[at + 3]
                line = ((c0 * f0 + c1 * f1) + c2 * f2) + c3 * f3
                plane += weights[1, v] * line
                if not only_value:
                    plane_y += slopes[1, v] * line
                    plane_z += weights[1, v] * (((d0 * f0 + d1 * f1) + d2 * f2) + d3 * f3)
            total += weights[0, u] * plane
            total_x += slopes[0, u] * plane
            total_y += weights[0, u] * plane_y
            total_z += weights[0, u] * plane_z
        for row, found in ((value, total), (dx, total_x), (dy, total_y), (dz, total_z)):
            if row >= 0:
                rows[row, i] = found if finite else math.nan


@njit_cached
def _elementary(rows, n, code, d, a, b, number):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Functions of the C library, point by point."""
    for i in range(n):
        t = rows[a, i]
        if code == _TAN:
            rows[d, i] = math.tan(t)
        elif code == _ASIN:
            rows[d, i] = math.asin(t) if -1.0 <= t <= 1.0 else math.nan
        elif code == _ACOS:
            rows[d, i] = math.acos(t) if -1.0 <= t <= 1.0 else math.nan
        elif code == _ATAN:
            rows[d, i] = math.atan(t)
        elif code == _SINH:
            rows[d, i] = math.sinh(t)
        elif code == _COSH:
            rows[d, i] = math.cosh(t)
        elif code == _TANH:
            rows[d, i] = math.tanh(t)
        elif code == _EXP:
            rows[d, i] = math.exp(t)
        elif code == _LOG:
            rows[d, i] = math.log(t) if t > 0.0 else (-math.inf if t == 0.0 else math.nan)
        elif code == _POWER:
            rows[d, i] = np.power(t, number)
        else:
            rows[d, i] = math.atan2(t, rows[b, i])


@njit_cached
def run_tape(code, parameters, n_rows, x_table, y_table, z_table, point_table, found):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Run the operations (m, 9) on all points of the grid of the tables' columns, into found (outputs, points).

    An operation is its code, the rows of up to four results, the rows of up to three operands, and the place of its parameters.
    Returns the parameter place of the first check that failed and the point, at which found[0] is the value checked; or -1, -1.
    """
    nx, ny, nz = x_table.shape[1], y_table.shape[1], z_table.shape[1]
    rows = np.zeros((n_rows, BLOCK))
    body = 0
    while body < len(code) and code[body, 0] == _CONSTANT:
        for i in range(BLOCK):
            rows[code[body, 1], i] = parameters[code[body, 8]]
        body += 1
    for line in range(nx * ny):
        ix, iy = line // ny, line % ny
        for start in range(0, nz, BLOCK):
            n = min(BLOCK, nz - start)
            at = line * nz + start
            k = body
            while k < len(code):
                op = code[k]
                k += 1
                kind, d, a, b, c, p = op[0], op[1], op[5], op[6], op[7], op[8]
                if kind == _MULTIPLY:
                    for i in range(n):
                        rows[d, i] = rows[a, i] * rows[b, i]
                elif kind == _ADD:
                    for i in range(n):
                        rows[d, i] = rows[a, i] + rows[b, i]
                elif kind == _SUBTRACT:
                    for i in range(n):
                        rows[d, i] = rows[a, i] - rows[b, i]
                elif kind == _SCALE:
                    number = parameters[p]
                    for i in range(n):
                        rows[d, i] = number * rows[a, i]
                elif kind == _SHIFT:
                    number = parameters[p]
                    for i in range(n):
                        rows[d, i] = rows[a, i] + number
                elif kind == _DIVIDE:
                    for i in range(n):
                        rows[d, i] = rows[a, i] / rows[b, i]
                elif kind == _CHAIN:
                    for i in range(n):
                        product = rows[a, i] * rows[b, i]
                        rows[d, i] = product if rows[b, i] != 0.0 else 0.0
                elif kind == _AT_LEAST:
                    for i in range(n):
                        rows[d, i] = 1.0 if rows[a, i] >= rows[b, i] else 0.0
                elif kind == _GREATER:
                    for i in range(n):
                        rows[d, i] = 1.0 if rows[a, i] > rows[b, i] else 0.0
                elif kind == _SELECT:
                    for i in range(n):
                        yes, no = rows[b, i], rows[c, i]
                        rows[d, i] = yes if rows[a, i] != 0.0 else no
                elif kind == _SINE_COSINE:
                    e = op[2]
                    for i in range(n):
                        rows[d, i], rows[e, i] = _sine_cosine(rows[a, i])
                    for i in range(n):
                        if not -REDUCTION_LIMIT <= rows[a, i] <= REDUCTION_LIMIT:
                            rows[d, i], rows[e, i] = math.sin(rows[a, i]), math.cos(rows[a, i])
                elif kind == _LOAD:
                    if b in (LOAD_X, LOAD_Y):
                        number = x_table[a, ix] if b == LOAD_X else y_table[a, iy]
                        for i in range(n):
                            rows[d, i] = number
                    elif b == LOAD_Z:
                        for i in range(n):
                            rows[d, i] = z_table[a, start + i]
                    else:
                        for i in range(n):
                            rows[d, i] = point_table[a, at + i]
                elif kind == _OUTPUT:
                    for i in range(n):
                        found[d, at + i] = rows[a, i]
                elif kind == _GUARD:
                    needed = False
                    for i in range(n):
                        needed |= rows[a, i] != 0.0
                    if not needed:
                        k = b
                elif kind == _ABSOLUTE:
                    for i in range(n):
                        rows[d, i] = abs(rows[a, i])
                elif kind == _ROOT:
                    for i in range(n):
                        rows[d, i] = np.sqrt(rows[a, i])
                elif kind == _PIECEWISE:
                    _piecewise(rows, n, d, op[2], a, p, parameters)
                elif kind == _TENSOR:
                    _tensor(rows, n, op, p, parameters)
                elif kind == _PERIODIC_SPLINE:
                    _periodic_spline(rows, n, op, p, parameters)
                elif kind == _CHECK:
                    low, high = parameters[p], parameters[p + 1]
                    for i in range(n):
                        if rows[b, i] != 0.0 and not low <= rows[a, i] <= high:
                            found[0, at + i] = rows[a, i]
                            return p, at + i
                        rows[d, i] = rows[a, i]
                else:
                    _elementary(rows, n, kind, d, a, b, parameters[p])
    return -1, -1
