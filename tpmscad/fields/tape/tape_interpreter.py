"""The compiled interpreter of tapes: elementary operations on blocks of points, one loop for each operation.

A tape is a list of operations on rows of numbers, one row for each intermediate value and one column for each point of a block.
Every loop is elementwise, so that a point has the same bits in every block. Sine and cosine are computed together, by argument
reduction (Cody and Waite) and the polynomials of fdlibm, which the compiler turns into vector instructions.

Everything is in this one module: Numba's cache does not notice that a function called from another module has changed.
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
def _list_needed_columns(rows, n, op):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The columns at which the results of an operation are needed: all, or those of its mask."""
    columns, mask = np.arange(n), op[9]
    if mask < 0:
        return columns
    found = 0
    for i in range(n):
        columns[found] = i
        found += rows[mask, i] != 0.0
    return columns[:found]


@njit_cached
def _are_on_line(rows, op, columns):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Whether the first two coordinates of a spline are the same in all columns, as along a line of a grid."""
    for i in range(1, len(columns)):
        for axis in range(2):
            if rows[op[5 + axis], columns[i]] != rows[op[5 + axis], columns[0]]:
                return False
    return len(columns) > 1


@njit_cached
def _tensor(rows, n, op, p, parameters, tables):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Tensor-product splines; parameters: the place of the table, orders, the numbers in the table, the polynomials of each axis.

    The polynomials of an axis are the number of its spans, their ends, the reciprocal of their mean length, and for each span
    the coefficients of the B-splines that are not zero there, those of the highest power first. Orders are rounded up to a whole
    number of fours by zeros, and the table of coefficients goes on with zeros along each axis.
    """
    columns = _list_needed_columns(rows, n, op)
    n, on_line = len(columns), _are_on_line(rows, op, columns)
    fours = (int(parameters[p + 1]) // 4, int(parameters[p + 2]) // 4, int(parameters[p + 3]) // 4)
    width, with_slopes = 4 * max(fours), op[2] >= 0 or op[3] >= 0 or op[4] >= 0
    splines, start = np.zeros((n, (6 if with_slopes else 3) * width)), np.zeros(n, np.uint64)
    height, depth = np.uint64(parameters[p + 5]), np.uint64(parameters[p + 6])
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    place = p + 7
    for axis in range(3):
        order, spans, ends = np.uint64(4 * fours[axis]), int(parameters[place]), np.uint64(place + 1)
        polynomials = place + spans + 3
        low, rate, stride = parameters[place + 1], parameters[polynomials - 1], (one, height, depth)[axis]
        if axis == 2 and on_line:
            start[1:] = start[0]
        for i in range(1 if axis < 2 and on_line else n):
            t = rows[op[5 + axis], columns[i]]
            guess = (t - low) * rate
            span = np.uint64(min(int(guess), spans - 1) if guess > 0.0 else 0)  # not a number: the first span
            while span > 0 and t < parameters[ends + span]:
                span -= one
            while span < spans - 1 and t >= parameters[ends + span + one]:
                span += one
            t -= parameters[ends + span]
            start[i] = start[i] * stride + span
            first = np.uint64(polynomials) + span * order * order
            for four in range(fours[axis]):
                v0 = v1 = v2 = v3 = s0 = s1 = s2 = s3 = 0.0
                at = first + np.uint64(4 * four)
                for _ in range(order):
                    if with_slopes:
                        s0, s1, s2, s3 = s0 * t + v0, s1 * t + v1, s2 * t + v2, s3 * t + v3
                    v0, v1 = v0 * t + parameters[at], v1 * t + parameters[at + one]
                    v2, v3 = v2 * t + parameters[at + two], v3 * t + parameters[at + three]
                    at += order
                j = axis * width + 4 * four
                splines[i, j], splines[i, j + 1], splines[i, j + 2], splines[i, j + 3] = v0, v1, v2, v3
                if with_slopes:
                    j += 3 * width
                    splines[i, j], splines[i, j + 1], splines[i, j + 2], splines[i, j + 3] = s0, s1, s2, s3
        place = polynomials + spans * (4 * fours[axis]) ** 2
    start += np.uint64(parameters[p])
    _sum_tensor_product(rows, columns, op, fours, height, depth, start, splines, on_line, tables)


@njit_cached
def _periodic_spline(rows, n, op, p, parameters, tables):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Cubic splines on periodic grids; parameters: the place of the table, the numbers of coefficients, and per unit of length.

    The table goes on for three coefficients beyond the period along each axis, so that those of an interval are consecutive.
    """
    columns = _list_needed_columns(rows, n, op)
    n, on_line = len(columns), _are_on_line(rows, op, columns)
    splines, start = np.empty((n, 24)), np.zeros(n, np.uint64)
    height, depth = np.uint64(parameters[p + 2] + 3.0), np.uint64(parameters[p + 3] + 3.0)
    for axis in range(3):
        count, rate, at = parameters[p + 1 + axis], parameters[p + 4 + axis], 4 * axis
        if axis == 2 and on_line:
            start[1:] = start[0]
        for i in range(1 if axis < 2 and on_line else n):
            u = rows[op[5 + axis], columns[i]] * rate
            base = math.floor(u)
            r = u - base
            s = 1.0 - r
            splines[i, at] = (s * s * s) / 6.0
            splines[i, at + 1] = (4.0 + (r * r) * (3.0 * r - 6.0)) / 6.0
            splines[i, at + 2] = (4.0 + (s * s) * (3.0 * s - 6.0)) / 6.0
            splines[i, at + 3] = (r * r * r) / 6.0
            splines[i, at + 12] = (-0.5 * rate) * (s * s)
            splines[i, at + 13] = (0.5 * rate) * (r * (3.0 * r - 4.0))
            splines[i, at + 14] = (-0.5 * rate) * (s * (3.0 * s - 4.0))
            splines[i, at + 15] = (0.5 * rate) * (r * r)
            interval = base - count * math.floor(base / count)
            # not a number for coordinates that are not finite, whose B-splines are not numbers either
            interval = interval if 0.0 <= interval < count else 0.0
            start[i] = start[i] * (np.uint64(1), height, depth)[axis] + np.uint64(interval)
    start += np.uint64(parameters[p])
    _sum_tensor_product(rows, columns, op, (1, 1, 1), height, depth, start, splines, on_line, tables)


@njit_cached
def _sum_tensor_product(rows, columns, op, fours, height, depth, start, splines, on_line, table):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Sums of coefficients times B-splines of three axes, and their derivatives, written to these columns of the result rows.

    `splines` (n, 6 w) holds the B-splines along x, y and z, and their slopes. The coefficients of a point begin at `start` of the
    table, with rows of `depth` numbers and planes of `height` rows. They are added four by four by four: loops of fixed length
    over unsigned indices take half the time of general ones.
    """
    n, width, plane = len(columns), 4 * max(fours), height * depth
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    total = np.zeros((4, n))
    with_slopes = op[2] >= 0 or op[3] >= 0 or op[4] >= 0
    is_summed = on_line and start.max() - start.min() < np.uint64(2 * n)
    if on_line and not is_summed:
        for first in range(0, splines.shape[1], 3 * width):
            for j in range(first, first + 2 * width):
                splines[1:, j] = splines[0, j]
    if is_summed:
        _sum_along_line(total, with_slopes, fours, height, depth, start, splines, table)
    for block in range(0 if is_summed else fours[0] * fours[1] * fours[2]):
        x = 4 * (block // (fours[1] * fours[2]))
        y = 4 * (block // fours[2] % fours[1])
        z = 4 * (block % fours[2])
        shift = (np.uint64(x) * height + np.uint64(y)) * depth + np.uint64(z)
        y, z = y + width, z + 2 * width
        dx, dy, dz = x + 3 * width, y + 3 * width, z + 3 * width
        for i in range(n):
            first = start[i] + shift
            a0 = a1 = a2 = a3 = b0 = b1 = b2 = b3 = c0 = c1 = c2 = c3 = 0.0
            for u in range(4):
                p0 = p1 = p2 = p3 = q0 = q1 = q2 = q3 = 0.0
                for v in range(4):
                    at = first + np.uint64(u) * plane + np.uint64(v) * depth
                    f0, f1, f2, f3 = table[at], table[at + one], table[at + two], table[at + three]
                    s = splines[i, y + v]
                    p0, p1, p2, p3 = p0 + s * f0, p1 + s * f1, p2 + s * f2, p3 + s * f3
                    if with_slopes:
                        s = splines[i, dy + v]
                        q0, q1, q2, q3 = q0 + s * f0, q1 + s * f1, q2 + s * f2, q3 + s * f3
                s = splines[i, x + u]
                a0, a1, a2, a3 = a0 + s * p0, a1 + s * p1, a2 + s * p2, a3 + s * p3
                if with_slopes:
                    c0, c1, c2, c3 = c0 + s * q0, c1 + s * q1, c2 + s * q2, c3 + s * q3
                    s = splines[i, dx + u]
                    b0, b1, b2, b3 = b0 + s * p0, b1 + s * p1, b2 + s * p2, b3 + s * p3
            s0, s1, s2, s3 = splines[i, z], splines[i, z + 1], splines[i, z + 2], splines[i, z + 3]
            total[0, i] += ((s0 * a0 + s1 * a1) + s2 * a2) + s3 * a3
            if with_slopes:
                total[1, i] += ((s0 * b0 + s1 * b1) + s2 * b2) + s3 * b3
                total[2, i] += ((s0 * c0 + s1 * c1) + s2 * c2) + s3 * c3
                s0, s1, s2, s3 = splines[i, dz], splines[i, dz + 1], splines[i, dz + 2], splines[i, dz + 3]
                total[3, i] += ((s0 * a0 + s1 * a1) + s2 * a2) + s3 * a3
    for k in range(4):
        if op[1 + k] >= 0:
            for i in range(n):
                rows[op[1 + k], columns[i]] = total[k, i]


@njit_cached
def _sum_along_line(total, with_slopes, fours, height, depth, start, splines, table):  # type: ignore[no-untyped-def]  # pragma: no cover
    """The same sums in the same order at points of a line along z: those along x and y once for each coefficient of the line."""
    n, width, row, plane = len(start), 4 * max(fours), np.int64(depth), np.int64(height * depth)
    low = np.int64(start.min())
    length = np.int64(start.max()) - low + 4 * fours[2]
    a, b, c, p, q = np.empty(length), np.empty(length), np.empty(length), np.empty(length), np.empty(length)
    for block in range(fours[0] * fours[1]):
        x, y = 4 * (block // fours[1]), 4 * (block % fours[1])
        a[:], b[:], c[:] = 0.0, 0.0, 0.0
        for u in range(x, x + 4):
            p[:], q[:] = 0.0, 0.0
            for v in range(y, y + 4):
                line = table[low + u * plane + v * row : low + u * plane + v * row + length]
                s = splines[0, width + v]
                for k in range(length):
                    p[k] += s * line[k]
                if with_slopes:
                    t = splines[0, 4 * width + v]
                    for k in range(length):
                        q[k] += t * line[k]
            s = splines[0, u]
            for k in range(length):
                a[k] += s * p[k]
            if with_slopes:
                t = splines[0, 3 * width + u]
                for k in range(length):
                    b[k] += t * p[k]
                    c[k] += s * q[k]
        for z in range(2 * width, 2 * width + 4 * fours[2], 4):
            for i in range(n):
                k = np.int64(start[i]) - low + z - 2 * width
                s0, s1, s2, s3 = splines[i, z], splines[i, z + 1], splines[i, z + 2], splines[i, z + 3]
                total[0, i] += ((s0 * a[k] + s1 * a[k + 1]) + s2 * a[k + 2]) + s3 * a[k + 3]
                if with_slopes:
                    total[1, i] += ((s0 * b[k] + s1 * b[k + 1]) + s2 * b[k + 2]) + s3 * b[k + 3]
                    total[2, i] += ((s0 * c[k] + s1 * c[k + 1]) + s2 * c[k + 2]) + s3 * c[k + 3]
                    j = z + 3 * width
                    s0, s1, s2, s3 = splines[i, j], splines[i, j + 1], splines[i, j + 2], splines[i, j + 3]
                    total[3, i] += ((s0 * a[k] + s1 * a[k + 1]) + s2 * a[k + 2]) + s3 * a[k + 3]


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
def run_tape(code, parameters, tables, n_rows, x_table, y_table, z_table, ends, point_table, found):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Run the operations (m, 10) on all points of the grid of the tables' columns, into found (outputs, points).

    An operation is its code, the rows of up to four results, the rows of up to three operands, the place of its parameters, and
    the row of the mask of the columns at which it is needed, -1 for all. Only operations that take long look at their mask.
    The coefficients of splines are in `tables`, None without splines. Blocks begin and end at the columns `ends` of the z table,
    at most BLOCK apart.
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
        for block in range(len(ends) - 1):
            start = ends[block]
            n = ends[block + 1] - start
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
                elif kind == _CHECK:
                    low, high = parameters[p], parameters[p + 1]
                    for i in range(n):
                        if rows[b, i] != 0.0 and not low <= rows[a, i] <= high:
                            found[0, at + i] = rows[a, i]
                            return p, at + i
                        rows[d, i] = rows[a, i]
                elif tables is not None:  # numba leaves this out for None, and does not compile the splines
                    if kind == _TENSOR:
                        _tensor(rows, n, op, p, parameters, tables)
                    elif kind == _PERIODIC_SPLINE:
                        _periodic_spline(rows, n, op, p, parameters, tables)
                    else:
                        _elementary(rows, n, kind, d, a, b, parameters[p])
                else:
                    _elementary(rows, n, kind, d, a, b, parameters[p])
    return -1, -1
