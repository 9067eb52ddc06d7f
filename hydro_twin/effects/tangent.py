"""Derivatives of the effects' laws, generated from the source of each law, or by differences.

The generated function takes what the law takes, returns the same value, and writes the partial
derivatives of the value, and of each number of the memory at the end of the step, by each number
that the law reads.
"""
from __future__ import annotations

import ast
from collections.abc import Callable
from typing import Any

from hydro_twin.effects.differentiate import Function, NoTangent
from hydro_twin.effects.syntax import loaded, names_in, stored_in

# Columns of the partial derivatives: value, both signals, compliance, then parameters and memory.
VALUE, SIGNAL, COMPLIANCE, PARAMETER = 0, 1, 3, 4


def law_tangent(law: Callable[..., Any], name: str) -> str:
    """Generate the derivative of the law of an effect.

    Args:
        law: as an effect declares it, compiled.
        name: of the function generated. It is name(v, s, p, z, h, c, z_next, g) -> value, and
            fills g, shape (1 + memory, 4 + parameters + memory).

    Raises:
        NoTangent: the law holds something that is not differentiated.
    """
    return _Law(law, name).generate()


class _Law(Function):
    """The law of an effect."""

    def begin(self) -> None:
        """Note the elements that are read; an index that may change cannot be followed."""
        v, s, p, z, _, c, z_next = self.arguments
        self._refuse_whole_arrays({s, p, z, z_next})
        varying = self._varying()
        self.columns: dict[str, str] = {}
        for name, column in ((v, VALUE), (c, COMPLIANCE)):
            self.follows[name] = {self.seed(name)}
            self.columns[name] = str(column)
        first = {s: f'{SIGNAL} + ', p: f'{PARAMETER} + ', z: f'{PARAMETER} + len({p}) + '}
        for node in self.nodes:
            if not isinstance(node, ast.Subscript) or not isinstance(node.value, ast.Name):
                continue
            text, index = ast.unparse(node), ast.unparse(node.slice)
            if node.value.id in first:
                if names_in(node.slice) & varying:
                    raise NoTangent(text)
                self.follows[text] = {self.seed(text)}
                self.columns[text] = first[node.value.id] + index
            elif node.value.id == z_next and isinstance(node.slice, ast.Constant):
                before = f'{z}[{index}]'
                self.follows[text] = {self.seed(before)}
                self.columns[before] = first[z] + index
            else:
                raise NoTangent(text)

    def _refuse_whole_arrays(self, arrays: set[str]) -> None:
        """Refuse arrays that are used otherwise than by element: what a helper does with them."""
        whole = [n for n in self.nodes if isinstance(n, ast.Name) and n.id in arrays]
        for node in self.nodes:
            if isinstance(node, ast.Subscript):
                whole = [n for n in whole if n is not node.value]
            elif isinstance(node, ast.Call) and ast.unparse(node.func) == 'len':
                whole = [n for n in whole if n not in node.args]
        if whole:
            raise NoTangent(whole[0].id)

    def _varying(self) -> set[str]:
        """List the names that are set more than once: twice in the text, or in a loop."""
        loops = [n for n in self.nodes if isinstance(n, ast.For | ast.While)]
        return {name for name in self.stored if self.stored.count(name) > 1} | {
            name for loop in loops for name in stored_in(ast.walk(loop))}

    def head(self) -> str:
        """Write the first line, and clear what is filled."""
        return f'def {self.name}({", ".join(self.arguments)}, partial_):\n    partial_[:] = 0.0'

    def at_begin(self, variable: str, seed: str) -> str:
        """Write a derivative as it is at first: what is not written is kept."""
        z, z_next = self.arguments[3], self.arguments[6]
        if variable.startswith(f'{z_next}['):
            variable = z + variable.removeprefix(z_next)
        return super().at_begin(variable, seed)

    def result(self, value: str, partials: dict[str, str]) -> None:
        """Write the derivatives and the return."""
        z_next = self.arguments[6]
        rows = {'0': partials} | {f'1 + {x[len(z_next) + 1:-1]}': {x: '1.0'}
                                  for x in self.follows if x.startswith(f'{z_next}[')}
        for row, found in rows.items():
            for seed, q in self.seeds.items():
                if (rate := self.rate(found, q)) == '0.0':
                    continue
                rate, column = self.total([rate]), self.columns[seed]
                # An element that this branch does not read may not even be there.
                read = names_in(loaded(ast.parse(seed, mode='eval').body))
                guard = f'if {rate} != 0.0: ' if read & set(self.stored) else ''
                self.line(f'{guard}partial_[{row}, {column}] += {rate}')
        self.line(f'return {value}')


DIFFERENCES = """

@compiled
def {name}(v, s, p, z, h, c, z_next, g):
    g[:] = 0.0
    for sign in (1.0, -1.0):
        step = sign * (1e-6 * abs(v) + 1e-12)
        keep(z, z_next)
        weigh({law}(v + step, s, p, z, h, c, z_next), z_next, 0.5 / step, g[:, 0])
        if c != 0.0:
            step = sign * 1e-6 * c
            keep(z, z_next)
            weigh({law}(v, s, p, z, h, c + step, z_next), z_next, 0.5 / step, g[:, 3])
        for array, first, size in ((s, 1, 2), (p, 4, len(p)), (z, 4 + len(p), len(z))):
            for i in range(size):
                held = array[i]
                step = sign * (1e-6 * abs(held) + 1e-12)
                array[i] = held + step
                keep(z, z_next)
                weigh({law}(v, s, p, z, h, c, z_next), z_next, 0.5 / step, g[:, first + i])
                array[i] = held
    keep(z, z_next)
    return {law}(v, s, p, z, h, c, z_next)
"""
WEIGH = """

@compiled
def keep(z, z_next):
    for k in range(len(z)):
        z_next[k] = z[k]


@compiled
def weigh(value, kept, factor, column):
    column[0] += factor * value
    for k in range(len(kept)):
        column[1 + k] += factor * kept[k]
"""


def law_differences(law: str, name: str) -> str:
    """Write a function as `law_tangent` does, but by central differences of the law's value.

    Args:
        law: the name of the law where the source is put.
        name: of the function generated.
    """
    return DIFFERENCES.format(law=law, name=name)
