"""Derivatives of functions of numbers: code generated from their source.

Statements are differentiated in forward mode: each variable carries its derivatives with respect
to the seeds on which it depends. The partial derivatives of an expression with respect to its
variables are found in reverse mode. Branches and loops stay as they are.
"""
from __future__ import annotations

import ast
from collections.abc import Callable, Sequence
import inspect
import textwrap
from typing import Any

from hydro_twin.effects.rules import BINARY, FUNCTIONS, INACTIVE
from hydro_twin.effects.syntax import assigned, Inlined, loaded, names_in, stored_in

# Names that generated code knows beside its own.
BUILT_IN = {'abs', 'float', 'int', 'len', 'math', 'max', 'min', 'range', 'round'}


class NoTangent(Exception):  # noqa: N818
    """A law holds something that is not differentiated here."""


class Function:
    """A helper of a law: numbers in, a number out, returned with its partial derivatives."""

    def __init__(self, function: Callable[..., Any], name: str) -> None:
        plain = getattr(function, 'py_func', function)
        definition = ast.parse(textwrap.dedent(inspect.getsource(plain))).body[0]
        if not isinstance(definition, ast.FunctionDef):
            raise NoTangent('not a function')
        self.name, self.globals = name, plain.__globals__
        self.body = definition.body
        self.arguments = [a.arg for a in definition.args.args]
        self.seeds: dict[str, str] = {}             # what it is differentiated by -> short name
        self.follows: dict[str, set[str]] = {}      # variable -> seeds that it depends on
        self.lines: list[str] = []
        self.helpers: dict[str, Function] = {}
        self.count = 0
        self.indent = 1
        self.nodes = [n for statement in self.body for n in ast.walk(statement)]
        self.pairs = [pair for node in self.nodes for pair in assigned(node)]
        self.stored = stored_in(self.nodes)
        self.begin()
        self.find_seeds()
        # Seeds never assigned, and names assigned once outside any block, need no initialisation.
        written = [ast.unparse(target) for target, _ in self.pairs]
        self.once = {x for x in self.seeds if x not in written} | {
            ast.unparse(target) for statement in self.body for target, _ in assigned(statement)
            if written.count(ast.unparse(target)) == 1 and isinstance(target, ast.Name)}

    def begin(self) -> None:
        """Note what the function is differentiated by."""
        for name in self.arguments:
            self.follows[name] = {self.seed(name)}

    def seed(self, text: str) -> str:
        """Note a number that the function is differentiated by."""
        return self.seeds.setdefault(text, f'{len(self.seeds)}')

    def generate(self) -> str:
        """Return the source, helpers first."""
        for statement in self.body:
            self.statement(statement)
        own = [f'    {_rate(x, q)} = {self.at_begin(x, q)}'
               for x, seeds in sorted(self.follows.items()) for q in sorted(seeds)
               if x not in self.once]
        return ''.join(helper.generate() for helper in self.helpers.values()) + '\n'.join(
            ['', '', '@compiled', self.head(), *own, *self.lines, ''])

    def head(self) -> str:
        """Write the first line."""
        return f'def {self.name}({", ".join(self.arguments)}):'

    def at_begin(self, variable: str, seed: str) -> str:
        """Write a derivative as it is at first."""
        return '1.0' if self.seeds.get(variable) == seed else '0.0'

    def result(self, value: str, partials: dict[str, str]) -> None:
        """Write the return."""
        rates = [self.rate(partials, q) for q in self.seeds.values()]
        self.line(f'return {", ".join([value, *rates])}')

    def line(self, text: str) -> None:
        """Write a line at the present depth."""
        self.lines.append('    ' * self.indent + text)

    def fresh(self) -> str:
        """Name a new variable."""
        self.count += 1
        return f'_{self.count}'

    def find_seeds(self) -> None:
        """Find what each variable depends on, until there is no more."""
        before = -1
        while before != sum(map(len, self.follows.values())):
            before = sum(map(len, self.follows.values()))
            for target, value in self.pairs:
                if found := self.depends(value):
                    self.follows.setdefault(ast.unparse(target), set()).update(found)

    def depends(self, node: ast.expr) -> set[str]:
        """Find the seeds that an expression depends on."""
        if isinstance(node, ast.Name | ast.Subscript):
            return self.follows.get(ast.unparse(node), set())
        if isinstance(node, ast.Compare | ast.BoolOp | ast.Constant):
            return set()
        if isinstance(node, ast.Call) and ast.unparse(node.func) in INACTIVE:
            return set()
        children = ((node.body, node.orelse) if isinstance(node, ast.IfExp)
                    else ast.iter_child_nodes(node))
        return {q for child in children if isinstance(child, ast.expr)
                for q in self.depends(child)}

    def plain(self, node: ast.expr) -> str:
        """Write an expression as it is, numbers of the module put in."""
        local = {*self.arguments, *self.stored}
        written = Inlined(self.globals, local).visit(loaded(node))
        if unknown := names_in(written) - local - BUILT_IN:
            raise NoTangent(unknown.pop())
        return ast.unparse(written)

    def nested(self, head: str, statements: Sequence[ast.stmt]) -> None:
        """Write a block under its head."""
        self.line(head)
        self.indent += 1
        for statement in statements:
            self.statement(statement)
        self.line('pass')
        self.indent -= 1

    def statement(self, node: ast.stmt) -> None:
        """Write one statement with its derivatives."""
        if pairs := assigned(node):
            targets = {name for target, _ in pairs for name in names_in(target)}
            if len(pairs) > 1 and any(targets & names_in(value) for _, value in pairs):
                raise NoTangent(ast.unparse(node))
            for target, value in pairs:
                self.assign(ast.unparse(target), value)
        elif isinstance(node, ast.If):
            self.nested(f'if {self.plain(node.test)}:', node.body)
            if node.orelse:
                self.nested('else:', node.orelse)
        elif isinstance(node, ast.For) and not node.orelse:
            self.nested(f'for {ast.unparse(node.target)} in {self.plain(node.iter)}:', node.body)
        elif isinstance(node, ast.While) and not node.orelse:
            self.nested(f'while {self.plain(node.test)}:', node.body)
        elif isinstance(node, ast.Return) and node.value is not None:
            self.result(*self.expression(node.value))
        elif isinstance(node, ast.Break | ast.Continue | ast.Pass):
            self.line(ast.unparse(node))
        elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            raise NoTangent(ast.unparse(node))

    def assign(self, target: str, value: ast.expr) -> None:
        """Write an assignment to a variable or an element."""
        found, partials = self.expression(value)
        for q in sorted(self.follows.get(target, ())):
            self.line(f'{_rate(target, q)} = {self.rate(partials, q)}')
        self.line(f'{target} = {found}')

    def rate(self, partials: dict[str, str], seed: str) -> str:
        """Write the derivative of an expression by a seed."""
        terms = []
        for x, partial in partials.items():
            if seed in self.follows[x]:
                own = '1.0' if x in self.seeds and x in self.once else _rate(x, seed)
                terms.append(partial if own == '1.0' else own if partial == '1.0'
                             else f'{partial} * {own}')
        return ' + '.join(terms) or '0.0'

    def expression(self, node: ast.expr) -> tuple[str, dict[str, str]]:
        """Write an expression; returns its value, and its partial derivative by each variable."""
        if not self.depends(node):
            return self.plain(node), {}
        tape: list[tuple[str, list[tuple[str, str]]]] = []
        leaves: set[str] = set()
        value = self.flatten(node, tape, leaves)
        adjoint: dict[str, list[str]] = {value: ['1.0']}
        for result, operands in reversed(tape):
            whole = self.total(adjoint.pop(result))
            for operand, partial in operands:
                adjoint.setdefault(operand, []).append(
                    whole if partial == '1.0' else f'({partial})' if whole == '1.0'
                    else f'{whole} * ({partial})')
        return value, {x: self.total(terms) for x, terms in adjoint.items() if x in leaves}

    def total(self, terms: Sequence[str]) -> str:
        """Write a sum, and name it unless it has a name."""
        if len(terms) == 1 and (terms[0].isidentifier() or terms[0] == '1.0'):
            return terms[0]
        whole = self.fresh()
        self.line(f'{whole} = {" + ".join(terms)}')
        return whole

    def flatten(self, node: ast.expr, tape: list[tuple[str, list[tuple[str, str]]]],
                leaves: set[str]) -> str:
        """Write an expression operation by operation; returns the name of its value."""
        if not self.depends(node):
            return f'({self.plain(node)})'
        if isinstance(node, ast.Name | ast.Subscript):
            leaves.add(ast.unparse(node))
            return ast.unparse(node)
        if isinstance(node, ast.IfExp):
            name = self.fresh()
            self.follows[name] = self.depends(node)
            self.once.add(name)
            for head, side in ((f'if {self.plain(node.test)}:', node.body),
                               ('else:', node.orelse)):
                self.line(head)
                self.indent += 1
                self.assign(name, side)
                self.indent -= 1
            leaves.add(name)
            return name
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.UAdd):
            sign = '-' if isinstance(node.op, ast.USub) else ''
            return self.operation([node.operand], sign + '{a}', [f'{sign}1.0'], tape, leaves)
        if isinstance(node, ast.BinOp) and type(node.op) in BINARY:
            value, *partials = BINARY[type(node.op)]
            return self.operation([node.left, node.right], value, partials, tape, leaves)
        if isinstance(node, ast.Call) and not node.keywords:
            return self.call(node, tape, leaves)
        raise NoTangent(ast.unparse(node))

    def operation(self, nodes: Sequence[ast.expr], value: str, partials: Sequence[str],
                  tape: list[tuple[str, list[tuple[str, str]]]], leaves: set[str]) -> str:
        """Write one operation and note its partial derivatives."""
        names = [self.flatten(node, tape, leaves) for node in nodes]
        result = self.fresh()
        held = dict(zip('ab', names, strict=False), r=result)
        self.line(f'{result} = {value.format(**held)}')
        tape.append((result, [
            (name, partial.format(**held)) for name, node, partial in
            zip(names, nodes, partials, strict=True) if self.depends(node)]))
        return result

    def call(self, node: ast.Call, tape: list[tuple[str, list[tuple[str, str]]]],
             leaves: set[str]) -> str:
        """Write a call of a known function, or of another compiled one."""
        known, arguments = ast.unparse(node.func), node.args
        if known == 'float':
            return self.flatten(arguments[0], tape, leaves)
        if known in FUNCTIONS:
            partials = FUNCTIONS[known]
            while len(arguments) > 2 and known in ('min', 'max'):
                arguments = [ast.Call(node.func, arguments[:2], []), *arguments[2:]]
            if len(arguments) != len(partials):
                raise NoTangent(ast.unparse(node))
            value = f'{known}({", ".join("{" + x + "}" for x in "ab"[:len(arguments)])})'
            return self.operation(arguments, value, partials, tape, leaves)
        function = self.globals.get(known)
        if function is None or not hasattr(function, 'py_func'):
            raise NoTangent(f'{known} is not a compiled function')
        if known not in self.helpers:
            self.helpers[known] = Function(function, f'{self.name}_{known}')
        names = [self.flatten(argument, tape, leaves) for argument in arguments]
        result, rates = self.fresh(), [self.fresh() for _ in names]
        self.line(f'{", ".join([result, *rates])} = {self.name}_{known}({", ".join(names)})')
        tape.append((result, [(name, rate) for name, argument, rate in
                              zip(names, arguments, rates, strict=True)
                              if self.depends(argument)]))
        return result


def _rate(variable: str, seed: str) -> str:
    """Name the derivative of a variable by a seed."""
    return f'd{seed}_' + ''.join(x if x.isalnum() else '_' for x in variable)
