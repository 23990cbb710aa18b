"""Mutants of a Python module: every comparison, operator, constant, condition and statement in turn made another."""

from __future__ import annotations

import ast
import copy
from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

COMPARISONS = (ast.Lt, ast.LtE, ast.Gt, ast.GtE)
OPERATORS: dict[type[ast.operator], tuple[type[ast.operator], ...]] = {
    ast.Add: (ast.Sub,), ast.Sub: (ast.Add,), ast.Mult: (ast.Div,), ast.Div: (ast.Mult,),
    ast.BitAnd: (ast.BitOr,), ast.BitOr: (ast.BitAnd, ast.BitXor), ast.LShift: (ast.RShift,),
}  # fmt: skip
CALLS = {"min": "max", "max": "min"}
DROPPED_CALLS = ("abs",)  # abs(x) becomes x
TRUE_CALLS = ("isfinite",)  # becomes True


class Mutant(NamedTuple):
    """One change. `name` says it without line numbers: function, what stood there, what stands there now."""

    name: str
    source: str


def mutants_of(source: str) -> list[Mutant]:
    """All mutants, in the order of the source; names are unique."""
    tree = ast.parse(source)
    found: list[Mutant] = []
    seen: dict[str, int] = {}
    for where, node, put in _places(tree):
        before = ast.unparse(node)
        for replacement in _replacements(node):
            undo = put(replacement)
            try:
                changed = ast.unparse(ast.fix_missing_locations(tree))
                after = "nothing" if isinstance(replacement, ast.Pass) else ast.unparse(replacement)
            finally:
                undo()
            name = f"{where}: {_short(before)} → {_short(after)}"
            seen[name] = seen.get(name, 0) + 1
            found.append(Mutant(name if seen[name] == 1 else f"{name} ({seen[name]})", changed))
    return found


Put = Callable[[ast.AST], Callable[[], None]]


def _places(tree: ast.Module) -> Iterator[tuple[str, ast.AST, Put]]:
    """Every node that may be replaced: where it stands, and how to put another one there."""
    for statement in tree.body:
        if isinstance(statement, ast.FunctionDef):
            for inner in statement.body[1:] if ast.get_docstring(statement) else statement.body:
                yield from _below(statement.name, statement.body, inner)
        elif isinstance(statement, ast.Assign) and not isinstance(statement.value, ast.Dict):
            yield from _fields(ast.unparse(statement.targets[0]), statement)


def _below(where: str, siblings: list[ast.stmt], statement: ast.stmt) -> Iterator[tuple[str, ast.AST, Put]]:
    position = siblings.index(statement)
    yield where, statement, lambda new: _set_item(siblings, position, new)
    for body in (getattr(statement, "body", []), getattr(statement, "orelse", [])):
        for inner in list(body):
            yield from _below(where, body, inner)
    yield from _fields(where, statement)


def _fields(where: str, node: ast.AST) -> Iterator[tuple[str, ast.AST, Put]]:
    """Expressions below a node (statements below it are `_below`'s)."""
    for name, value in ast.iter_fields(node):
        if isinstance(value, ast.expr):
            yield where, value, lambda new, name=name: _set_field(node, name, new)
            yield from _fields(where, value)
        elif isinstance(value, list):
            for position, item in enumerate(value):
                if isinstance(item, ast.expr):
                    yield where, item, lambda new, value=value, position=position: _set_item(value, position, new)
                    yield from _fields(where, item)


def _set_field(node: ast.AST, name: str, new: ast.AST) -> Callable[[], None]:
    old = getattr(node, name)
    setattr(node, name, new)
    return lambda: setattr(node, name, old)


def _set_item(items: list[Any], position: int, new: ast.AST) -> Callable[[], None]:
    old = items[position]
    items[position] = new

    def undo() -> None:
        items[position] = old

    return undo


def _replacements(node: ast.AST) -> Iterator[ast.AST]:
    """What may stand in the place of a node."""
    if isinstance(node, ast.stmt):
        yield from _statements(node)
    elif isinstance(node, ast.Compare):
        yield from _comparisons(node)
    elif isinstance(node, ast.BoolOp):
        yield _changed(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And())
        for position in range(len(node.values)):
            rest = [value for index, value in enumerate(node.values) if index != position]
            yield rest[0] if len(rest) == 1 else _changed(node, values=rest)
    elif isinstance(node, ast.UnaryOp):
        yield node.operand
    elif isinstance(node, ast.BinOp):
        for operator in OPERATORS.get(type(node.op), ()):
            yield _changed(node, op=operator())
    elif isinstance(node, ast.Constant):
        yield from _constants(node)
    elif isinstance(node, ast.Call):
        yield from _calls(node)
    elif isinstance(node, ast.IfExp):
        yield node.body
        yield node.orelse


def _statements(node: ast.stmt) -> Iterator[ast.AST]:
    if isinstance(node, ast.If):
        yield _changed(node, test=ast.Constant(True))
        yield _changed(node, test=ast.Constant(False))
    elif isinstance(node, ast.AugAssign):
        for operator in OPERATORS.get(type(node.op), ()):
            yield _changed(node, op=operator())
        yield ast.Pass()
    elif isinstance(node, ast.Assign | ast.Return | ast.For):
        yield ast.Pass()


def _comparisons(node: ast.Compare) -> Iterator[ast.AST]:
    for position, operator in enumerate(node.ops):
        if isinstance(operator, COMPARISONS):
            others: tuple[type[ast.cmpop], ...] = tuple(kind for kind in COMPARISONS if kind is not type(operator))
        else:
            others = (ast.NotEq,) if isinstance(operator, ast.Eq) else (ast.Eq,)
        for other in others:
            yield _changed(node, ops=[*node.ops[:position], other(), *node.ops[position + 1 :]])


def _constants(node: ast.Constant) -> Iterator[ast.AST]:
    if isinstance(node.value, bool):
        yield ast.Constant(not node.value)
    elif isinstance(node.value, int | float):
        yield ast.Constant(node.value + 1)
        if node.value != 0:
            yield ast.Constant(node.value - 1)
        elif isinstance(node.value, float):
            yield ast.Constant(-1.0)


def _calls(node: ast.Call) -> Iterator[ast.AST]:
    name = ast.unparse(node.func).rpartition(".")[2]
    if name in CALLS:
        yield _changed(node, func=ast.Name(CALLS[name], ast.Load()))
        yield from node.args
    elif name in DROPPED_CALLS:
        yield node.args[0]
    elif name in TRUE_CALLS:
        yield ast.Constant(True)


def _changed(node: ast.AST, **fields: object) -> ast.AST:
    new = copy.copy(node)
    for name, value in fields.items():
        setattr(new, name, value)
    return new


def _short(text: str) -> str:
    first, *rest = text.splitlines()
    return f"{first} …" if rest else first
