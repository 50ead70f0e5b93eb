"""Mutants of a source file: each has one small, plausible mistake inside one function.

The mistakes are the usual ones of mutation testing (Jia and Harman, *An Analysis and Survey of the Development of
Mutation Testing*, 2011): a comparison shifted or reversed, operators exchanged, a constant changed, a condition
negated, a statement left out. Texts, and code that only makes texts (an f-string, the message of an exception, a log
line), are not changed, as wording is not behavior.
"""

import ast
import copy
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from types import CodeType

COMPARISONS: dict[type[ast.cmpop], tuple[type[ast.cmpop], ...]] = {
    ast.Lt: (ast.LtE, ast.GtE),
    ast.LtE: (ast.Lt, ast.Gt),
    ast.Gt: (ast.GtE, ast.LtE),
    ast.GtE: (ast.Gt, ast.Lt),
    ast.Eq: (ast.NotEq,),
    ast.NotEq: (ast.Eq,),
    ast.Is: (ast.IsNot,),
    ast.IsNot: (ast.Is,),
    ast.In: (ast.NotIn,),
    ast.NotIn: (ast.In,),
}
OPERATORS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.Div,
    ast.Div: ast.Mult,
    ast.FloorDiv: ast.Mult,
    ast.Mod: ast.Mult,
    ast.Pow: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
    ast.LShift: ast.RShift,
    ast.RShift: ast.LShift,
}
LOG_CALLS = frozenset({"debug", "info", "warning", "error", "exception", "log"})
"""Functions that write to a log; leaving out such a call does not count as a mistake."""


@dataclass(frozen=True, order=True)
class Mutant:
    """One change of one function.

    Attributes:
        path: the file, relative to the project's root.
        function: the qualified name of the outermost function or method that contains the change.
        line: the line of the change, from 1.
        number: which of the function's mutants this is, from 0, in the order of the source.
        change: source text before and after, for people.

    """

    path: str
    function: str
    line: int
    number: int
    change: str

    @property
    def name(self) -> str:
        """Identifies the mutant as long as its function is not edited."""
        return f"{self.path}::{self.function}::{self.change}"


def mutants_of(root: Path, path: str) -> list[Mutant]:
    """All mutants of a file, in source order."""
    tree = ast.parse((root / path).read_text())
    found = []
    for name, function in _functions(tree):
        found += [
            Mutant(path, name, change.line, number, change.words) for number, change in enumerate(_changes(function))
        ]
    return found


def compile_mutant(root: Path, mutant: Mutant, filename: str) -> CodeType:
    """The compiled code of the module with the mutant applied.

    Raises:
        LookupError: the file has no such mutant (it was edited since).

    """
    tree = ast.parse((root / mutant.path).read_text())
    for name, function in _functions(tree):
        if name != mutant.function:
            continue
        for number, change in enumerate(_changes(function)):
            if (number, change.line, change.words) == (mutant.number, mutant.line, mutant.change):
                change.apply()
                return compile(ast.fix_missing_locations(tree), filename, "exec", dont_inherit=True)
    raise LookupError(f"no such mutant: {mutant.name}")


def code_of(module: CodeType, function: str, line: int) -> CodeType:
    """The code object of a function within a module's code, by qualified name and first line."""
    waiting = [module]
    while waiting:
        code = waiting.pop()
        if code.co_qualname == function and code.co_firstlineno == line:
            return code
        waiting.extend(constant for constant in code.co_consts if isinstance(constant, CodeType))
    raise LookupError(f"no function {function} at line {line}")


@dataclass(frozen=True)
class _Place:
    """Position of a node in the tree."""

    parent: ast.AST
    field: str
    index: int | None = None

    def put(self, node: ast.AST) -> None:
        if self.index is None:
            setattr(self.parent, self.field, node)
        else:
            getattr(self.parent, self.field)[self.index] = node


@dataclass(frozen=True)
class _Change:
    """Replacement of one node by another; the tree is unchanged until `apply`."""

    old: ast.expr | ast.stmt
    new: ast.AST
    place: _Place

    @property
    def line(self) -> int:
        return self.old.lineno

    @property
    def words(self) -> str:
        return f"{_shown(self.old)} -> {_shown(self.new)}"

    def apply(self) -> None:
        self.place.put(self.new)


def _functions(tree: ast.Module) -> Iterator[tuple[str, ast.FunctionDef | ast.AsyncFunctionDef]]:
    """Outermost functions and methods; protocols, overloads and abstract functions have no behavior."""
    waiting: list[tuple[str, ast.stmt]] = [("", statement) for statement in reversed(tree.body)]
    while waiting:
        before, node = waiting.pop()
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield before + node.name, node
        elif isinstance(node, ast.ClassDef) and not _is_protocol(node):
            waiting.extend((f"{before}{node.name}.", statement) for statement in reversed(node.body))
        elif isinstance(node, ast.If | ast.Try | ast.With):
            waiting.extend((before, statement) for statement in reversed(node.body))


def _is_protocol(node: ast.ClassDef) -> bool:
    return any("Protocol" in ast.unparse(base) for base in node.bases)


def _changes(function: ast.FunctionDef | ast.AsyncFunctionDef) -> Iterator[_Change]:
    if function.name in {"__repr__", "__str__"}:
        return
    for index, statement in enumerate(function.body):
        yield from _of_statement(function, "body", index, statement)


def _of_statement(parent: ast.AST, field: str, index: int, node: ast.stmt) -> Iterator[_Change]:
    if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant):
        return  # a docstring, or `...`
    if _only_logs(node):
        return
    yield from _skipped(parent, field, index, node)
    if isinstance(node, ast.Raise):
        return  # the rest is the error message
    if isinstance(node, ast.AugAssign) and type(node.op) in OPERATORS:
        new = copy.copy(node)
        new.op = OPERATORS[type(node.op)]()
        yield _Change(node, new, _Place(parent, field, index))
    if isinstance(node, ast.If | ast.While):
        yield from _negated(node)
    for name, value in ast.iter_fields(node):
        if name not in {"annotation", "decorator_list", "returns", "targets", "target"}:
            yield from _of_value(node, name, value)


def _of_value(node: ast.AST, name: str, value: object) -> Iterator[_Change]:
    if isinstance(value, ast.expr):
        yield from _of_expression(node, name, None, value)
    elif isinstance(value, list):
        for index, item in enumerate(value):
            if isinstance(item, ast.stmt):
                yield from _of_statement(node, name, index, item)
            elif isinstance(item, ast.expr):
                yield from _of_expression(node, name, index, item)
            elif isinstance(item, ast.ExceptHandler | ast.match_case):
                yield from _of_value(item, "body", item.body)
            elif isinstance(item, ast.withitem):
                yield from _of_value(item, "context_expr", item.context_expr)
            elif isinstance(item, ast.keyword):
                yield from _of_value(item, "value", item.value)
            elif isinstance(item, ast.comprehension):
                yield from _of_value(item, "iter", item.iter)
                yield from _of_value(item, "ifs", item.ifs)


def _skipped(parent: ast.AST, field: str, index: int, node: ast.stmt) -> Iterator[_Change]:
    new: ast.stmt
    if isinstance(node, ast.Return):
        if node.value is None or (isinstance(node.value, ast.Constant) and node.value.value is None):
            return
        new = ast.copy_location(ast.Return(value=ast.Constant(value=None)), node)
    elif isinstance(node, ast.Expr | ast.Raise | ast.Continue | ast.Break | ast.AugAssign | ast.Delete) or (
        isinstance(node, ast.Assign)
        and all(isinstance(target, ast.Attribute | ast.Subscript) for target in node.targets)
    ):
        new = ast.copy_location(ast.Pass(), node)
    else:
        return
    yield _Change(node, new, _Place(parent, field, index))


def _only_logs(node: ast.stmt) -> bool:
    """Whether a statement only writes to a log."""
    return (
        isinstance(node, ast.Expr)
        and isinstance(node.value, ast.Call)
        and isinstance(node.value.func, ast.Attribute)
        and node.value.func.attr in LOG_CALLS
    )


def _negated(node: ast.If | ast.While) -> Iterator[_Change]:
    if isinstance(node.test, ast.Compare) or (isinstance(node.test, ast.Constant) and node.test.value is True):
        return  # comparisons are reversed below; negating `while True` would only hang
    new = ast.copy_location(ast.UnaryOp(op=ast.Not(), operand=node.test), node.test)
    yield _Change(node.test, new, _Place(node, "test", None))


def _of_expression(parent: ast.AST, field: str, index: int | None, node: ast.expr) -> Iterator[_Change]:
    if isinstance(node, ast.JoinedStr):
        return
    for new in _replacements(node):
        yield _Change(node, new, _Place(parent, field, index))
    for name, value in ast.iter_fields(node):
        if name != "func" or not isinstance(value, ast.Name):
            yield from _of_value(node, name, value)


def _replacements(node: ast.expr) -> Iterator[ast.expr]:
    if isinstance(node, ast.Compare) and len(node.ops) == 1:
        for comparison in COMPARISONS.get(type(node.ops[0]), ()):
            yield ast.copy_location(ast.Compare(node.left, [comparison()], node.comparators), node)
    elif isinstance(node, ast.BoolOp):
        other: ast.boolop = ast.Or() if isinstance(node.op, ast.And) else ast.And()
        yield ast.copy_location(ast.BoolOp(other, node.values), node)
    elif isinstance(node, ast.BinOp) and type(node.op) in OPERATORS and not _makes_text(node):
        yield ast.copy_location(ast.BinOp(node.left, OPERATORS[type(node.op)](), node.right), node)
    elif isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub | ast.Not):
        if not (isinstance(node.operand, ast.Constant) and isinstance(node.op, ast.USub)):
            yield node.operand
    elif isinstance(node, ast.IfExp):
        yield ast.copy_location(
            ast.IfExp(ast.copy_location(ast.UnaryOp(ast.Not(), node.test), node.test), node.body, node.orelse), node
        )
    elif isinstance(node, ast.Constant):
        if isinstance(node.value, bool):
            yield ast.copy_location(ast.Constant(not node.value), node)
        elif isinstance(node.value, int):
            yield ast.copy_location(ast.Constant(node.value + 1), node)
        elif isinstance(node.value, float):
            yield ast.copy_location(ast.Constant(node.value * 2 if node.value else 1.0), node)


def _makes_text(node: ast.BinOp) -> bool:
    return any(
        isinstance(side, ast.JoinedStr) or (isinstance(side, ast.Constant) and isinstance(side.value, str))
        for side in (node.left, node.right)
    )


def _shown(node: ast.AST) -> str:
    text = " ".join(ast.unparse(node).split())
    return text if len(text) <= 100 else f"{text[:97]}..."
