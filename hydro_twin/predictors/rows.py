"""Rows of numbers as vectors of the processor: multiples and weighted sums of them.

A row is a whole number of vectors of `WIDTH` numbers; an array of rows has the shape (rows,
vectors, WIDTH). LLVM would vectorise loops over rows by itself, but it checks before each whether
the arrays overlap, and puts a copy of it wherever it is called: for so few numbers that takes
several times as long as the sums, most of it to fetch the code. So the vectors are written out
here, in functions that are not inlined. No index is checked.
"""
from __future__ import annotations

from collections.abc import Callable
import math
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
import numpy as np

from hydro_twin.arrays import FloatArray

WIDTH = 16
LINE = 64               # bytes in a line of the cache
DOUBLE, INDEX = ir.DoubleType(), ir.IntType(64)
POINTER = DOUBLE.as_pointer()
VECTOR = ir.VectorType(DOUBLE, WIDTH)


def zeros(count: int, vectors: int) -> FloatArray:
    """Allocate rows of zeros, (count, vectors, `WIDTH`), aligned to the lines of the cache.

    A vector that lies across two lines takes twice as long, and longer where it was just written.
    """
    numbers, line = count * vectors * WIDTH, LINE // 8
    room = np.zeros(numbers + line)
    first = -(room.ctypes.data // 8) % line
    found: FloatArray = room[first:first + numbers].reshape(count, vectors, WIDTH)
    return found


def in_rows(columns: FloatArray) -> FloatArray:
    """Lay out (..., D) as rows, (rows, vectors, `WIDTH`), with zeros beyond D."""
    count, D = math.prod(columns.shape[:-1]), columns.shape[-1]
    vectors = math.ceil(D / WIDTH)
    rows = zeros(count, vectors)
    rows.reshape(count, vectors * WIDTH)[:, :D] = columns.reshape(count, D)
    return rows


def _vector(builder: Any, row: Any, index: Any) -> Any:
    """Point at a vector of a row."""
    begin = builder.gep(row, [builder.mul(index, INDEX(WIDTH))])
    return builder.bitcast(begin, VECTOR.as_pointer())


def _load(builder: Any, row: Any, index: Any) -> Any:
    return builder.load(_vector(builder, row, index), align=8)


def _store(builder: Any, value: Any, row: Any, index: Any) -> None:
    builder.store(value, _vector(builder, row, index), align=8)


def _times(builder: Any, factor: Any, vector: Any) -> Any:
    """Multiply a vector by a number."""
    one = builder.insert_element(ir.Constant(VECTOR, ir.Undefined), factor, ir.IntType(32)(0))
    spread = builder.shuffle_vector(one, ir.Constant(VECTOR, ir.Undefined),
                                    ir.Constant(ir.VectorType(ir.IntType(32), WIDTH), [0] * WIDTH))
    return builder.fmul(spread, vector)


def _clear(builder: Any, vectors: Any, out: Any) -> None:
    with cgutils.for_range(builder, vectors) as loop:
        _store(builder, ir.Constant(VECTOR, [DOUBLE(0.0)] * WIDTH), out, loop.index)


def _put(builder: Any, vectors: Any, out: Any, factor: Any, row: Any) -> None:
    with cgutils.for_range(builder, vectors) as loop:
        _store(builder, _times(builder, factor, _load(builder, row, loop.index)), out, loop.index)


def _add(builder: Any, vectors: Any, out: Any, factor: Any, row: Any) -> None:
    with cgutils.for_range(builder, vectors) as loop:
        more = _times(builder, factor, _load(builder, row, loop.index))
        _store(builder, builder.fadd(_load(builder, out, loop.index), more), out, loop.index)


def _copy(builder: Any, vectors: Any, out: Any, row: Any, count: Any) -> None:
    with cgutils.for_range(builder, builder.mul(count, vectors)) as loop:
        _store(builder, _load(builder, row, loop.index), out, loop.index)


def _combine(builder: Any, vectors: Any, out: Any, count: Any, fresh: Any, factors: Any,
             factor_by_row: Any, factor_by_term: Any, rows: Any, row_by_row: Any, row_by_term: Any,
             terms: Any) -> None:
    total = cgutils.alloca_once(builder, VECTOR)  # type: ignore[no-untyped-call]
    nothing = ir.Constant(VECTOR, [DOUBLE(0.0)] * WIDTH)
    with cgutils.for_range(builder, count) as row, cgutils.for_range(builder, vectors) as vector:
        to = builder.add(builder.mul(row.index, vectors), vector.index)
        builder.store(nothing, total)
        with builder.if_then(builder.not_(fresh)):
            builder.store(_load(builder, out, to), total)
        with cgutils.for_range(builder, terms) as term:
            at = builder.add(builder.mul(row.index, row_by_row),
                             builder.mul(term.index, row_by_term))
            which = builder.add(builder.mul(row.index, factor_by_row),
                                builder.mul(term.index, factor_by_term))
            more = _times(builder, builder.load(builder.gep(factors, [which])),
                          _load(builder, rows, builder.add(builder.mul(at, vectors),
                                                           vector.index)))
            builder.store(builder.fadd(builder.load(total), more), total)
        _store(builder, builder.load(total), out, to)


def _function(builder: Any, body: Callable[..., None], kinds: list[Any]) -> Any:
    """Return the LLVM function made from `body`; add it to the module where it is missing."""
    name = f'hydro_twin_rows{body.__name__}'
    module = builder.module
    if name not in module.globals:
        function = ir.Function(module, ir.FunctionType(ir.VoidType(), kinds), name)
        function.linkage = 'linkonce_odr'
        # Without `optsize` loops are unrolled, and over so few rows they then take longer.
        function.attributes.add('noinline')
        function.attributes.add('optsize')
        inside = ir.IRBuilder(function.append_basic_block())
        body(inside, *function.args)
        inside.ret_void()
    return module.globals[name]


def _row(context: Any, builder: Any, kind: Any, array: Any, index: Any) -> tuple[Any, Any]:
    """Point at a row of an array, and say how many vectors it has."""
    held = context.make_array(kind)(context, builder, array)
    vectors = builder.extract_value(held.shape, 1)
    size = builder.mul(vectors, INDEX(WIDTH))
    return builder.gep(held.data, [builder.mul(index, size)]), vectors


def operation(typed: Callable[..., Any]) -> Callable[..., None]:
    """Make a numba intrinsic of a function that returns a signature and a code generator."""
    made: Callable[..., None] = intrinsic(typed)
    return made


@operation
def clear(_typing, out, _i):  # type: ignore[no-untyped-def]
    """Set row i of out to zero."""
    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        to, vectors = _row(context, builder, signature.args[0], *args)
        builder.call(_function(builder, _clear, [INDEX, POINTER]), [vectors, to])
        return context.get_dummy_value()
    return types.void(out, types.int64), generate


def _two_rows(body: Callable[..., None]) -> Callable[..., Any]:
    """Generate a call with an output row, a factor and an input row."""
    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        out, i, factor, rows, j = args
        to, vectors = _row(context, builder, signature.args[0], out, i)
        row, _ = _row(context, builder, signature.args[3], rows, j)
        builder.call(_function(builder, body, [INDEX, POINTER, DOUBLE, POINTER]),
                     [vectors, to, factor, row])
        return context.get_dummy_value()
    return generate


@operation
def put(_typing, out, _i, _factor, rows, _j):  # type: ignore[no-untyped-def]
    """Set row i of out to factor times row j of rows."""
    return types.void(out, types.int64, types.float64, rows, types.int64), _two_rows(_put)


@operation
def add(_typing, out, _i, _factor, rows, _j):  # type: ignore[no-untyped-def]
    """Add factor times row j of rows to row i of out."""
    return types.void(out, types.int64, types.float64, rows, types.int64), _two_rows(_add)


@operation
def copy(_typing, out, rows, _count):  # type: ignore[no-untyped-def]
    """Copy the first `count` rows of rows to out."""
    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        out, rows, count = args
        to, vectors = _row(context, builder, signature.args[0], out, INDEX(0))
        row, _ = _row(context, builder, signature.args[1], rows, INDEX(0))
        builder.call(_function(builder, _copy, [INDEX, POINTER, POINTER, INDEX]),
                     [vectors, to, row, count])
        return context.get_dummy_value()
    return types.void(out, rows, types.int64), generate


@operation
def combine(  # type: ignore[no-untyped-def]
        _typing, out, _count, _fresh, factors, _at, _factor_by_row, _factor_by_term, rows, _j,
        _row_by_row, _row_by_term, _terms):
    """Add to the first `count` rows of out a sum of rows, each times its factor.

    Row k receives the sum over q of factors[at + k factor_by_row + q factor_by_term], indexed as a
    flat array, times row j + k row_by_row + q row_by_term of rows. Where `fresh`, the sum replaces
    the row.
    """
    def generate(context, builder, signature, args):  # type: ignore[no-untyped-def]
        (out, count, fresh, factors, at, factor_by_row, factor_by_term, rows, j, row_by_row,
         row_by_term, terms) = args
        to, vectors = _row(context, builder, signature.args[0], out, INDEX(0))
        row, _ = _row(context, builder, signature.args[7], rows, j)
        data = context.make_array(signature.args[3])(context, builder, factors).data
        given = [vectors, to, count, fresh, builder.gep(data, [at]), factor_by_row, factor_by_term,
                 row, row_by_row, row_by_term, terms]
        kinds = [INDEX, POINTER, INDEX, ir.IntType(1), POINTER, INDEX, INDEX, POINTER,
                 *[INDEX] * 3]
        builder.call(_function(builder, _combine, kinds), given)
        return context.get_dummy_value()
    whole = types.int64
    return types.void(out, whole, types.boolean, factors, whole, whole, whole, rows, whole, whole,
                      whole, whole), generate
