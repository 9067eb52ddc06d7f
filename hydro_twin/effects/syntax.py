"""Pieces of the syntax tree of a function: what it assigns, what it names, its constants."""
from __future__ import annotations

import ast
from collections.abc import Iterable
import math
from types import ModuleType
from typing import Any


class Inlined(ast.NodeTransformer):
    """Puts the numbers of a module in the place of their names."""

    def __init__(self, names: dict[str, Any], local: set[str]) -> None:
        self.names, self.local = names, local

    def visit_Name(self, node: ast.Name) -> ast.expr:
        """Replace a global number."""
        return node if node.id in self.local else self.number(self.names.get(node.id), node)

    def visit_Attribute(self, node: ast.Attribute) -> ast.expr:
        """Replace a number of an imported module, as math.pi."""
        owner = self.names.get(node.value.id) if isinstance(node.value, ast.Name) else None
        return self.number(getattr(owner, node.attr, None), node) if isinstance(
            owner, ModuleType) else node

    def number(self, value: Any, node: ast.expr) -> ast.expr:
        """Write a number, or leave what is none."""
        if not isinstance(value, int | float):
            return node
        value = float(value) if isinstance(value, float) else int(value)    # not one of numpy's
        written = repr(value) if math.isfinite(value) else f"float('{value}')"
        return ast.parse(written, mode='eval').body


def assigned(node: ast.AST) -> list[tuple[ast.expr, ast.expr]]:
    """List the targets of an assignment with what each is set to."""
    if isinstance(node, ast.AugAssign):
        return [(node.target, ast.BinOp(loaded(node.target), node.op, node.value))]
    if not isinstance(node, ast.Assign) or len(node.targets) != 1:
        return []
    target = node.targets[0]
    if isinstance(target, ast.Tuple) and isinstance(node.value, ast.Tuple):
        return list(zip(target.elts, node.value.elts, strict=True))
    return [(target, node.value)]


def names_in(node: ast.AST) -> set[str]:
    """List the names in a piece of code."""
    return {n.id for n in ast.walk(node) if isinstance(n, ast.Name)}


def stored_in(nodes: Iterable[ast.AST]) -> list[str]:
    """List the names that nodes set, as often as they do."""
    return [n.id for n in nodes if isinstance(n, ast.Name) and isinstance(n.ctx, ast.Store)]


def loaded(node: ast.expr) -> ast.expr:
    """Return a copy of an expression that is read, as that of an assignment's target."""
    return ast.parse(ast.unparse(node), mode='eval').body
