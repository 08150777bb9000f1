"""Filter expressions such as ``vs > 1500 and status == 'done'``, turned into bound SQL parameters.

The text is parsed as a Python expression. Only comparisons of known quantities with literals are accepted, so no part
of it reaches the database as SQL.
"""

import ast
import difflib
import io
import math
import operator
import sys
import tokenize
from collections.abc import Callable
from typing import Any

from sqlalchemy import ColumnElement, SQLColumnExpression, and_, literal, not_, or_

from calcidem.storage.errors import QueryError
from calcidem.storage.records import LARGEST_SEED, QUANTITY_BY_NAME
from calcidem.storage.sql.tables import EXPRESSIONS

_COMPARISONS: dict[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
}

_EXAMPLE = 'Write for example "vs > 1500 and status == \'done\'", "content in (4, 5)" or "vs_peak is None".'


def parse_where(text: str) -> ColumnElement[bool]:
    """Convert a filter expression to a condition of a query.

    It compares quantities (``< <= > >= == = !=``, ``in``, ``not in``, ``is None``, ``is not None``) with numbers or
    quoted words, joined by ``and``, ``or``, ``not`` and parentheses. `QueryError` for any other text or an unknown
    quantity.
    """
    if len(text) > 10_000:
        raise QueryError(f"The filter has {len(text)} characters.", "Write it in at most 10,000.")
    try:
        tree = ast.parse(_python_equality(text), mode="eval")
        comparisons = sum(len(node.ops) for node in ast.walk(tree) if isinstance(node, ast.Compare))
        if comparisons > 200 or _depth(tree) > 50:  # SQLite refuses expressions of a thousand levels
            raise QueryError(
                f"The filter has {comparisons} comparisons, nested {_depth(tree)} deep.",
                "Write at most 200, at most 50 deep; many values are 'seed in (1, 2)'.",
            )
        return _condition(tree.body, text)
    # Deep nesting makes Python's parser raise other errors.
    except (SyntaxError, ValueError, tokenize.TokenError, RecursionError, MemoryError) as error:
        raise QueryError(f"The filter {text!r} can't be read.", _EXAMPLE) from error


def _python_equality(text: str) -> str:
    """Replace a single ``=``, as in SQL, by ``==``."""
    tokens = tokenize.generate_tokens(io.StringIO(text.strip()).readline)
    return tokenize.untokenize((t.type, "==" if t.string == "=" else t.string) for t in tokens)


def _depth(node: ast.AST) -> int:
    """Depth of an expression, including its root."""
    return 1 + max(map(_depth, ast.iter_child_nodes(node)), default=0)


def _condition(node: ast.expr, text: str) -> ColumnElement[bool]:
    if isinstance(node, ast.BoolOp):
        join = and_ if isinstance(node.op, ast.And) else or_
        return join(*(_condition(value, text) for value in node.values))
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
        return not_(_condition(node.operand, text))
    if isinstance(node, ast.Compare):
        sides = [node.left, *node.comparators]
        pairs = zip(sides, node.ops, sides[1:], strict=False)
        return and_(*(_comparison(left, op, right, text) for left, op, right in pairs))
    raise QueryError(f"'{ast.unparse(node)}' in the filter '{text}' is not a comparison.", _EXAMPLE)


def _comparison(left: ast.expr, op: ast.cmpop, right: ast.expr, text: str) -> ColumnElement[bool]:
    first = _operand(left, text)
    if isinstance(op, ast.Is | ast.IsNot):
        if not (isinstance(right, ast.Constant) and right.value is None):
            raise QueryError(f"'is' in the filter '{text}' is allowed with None only.", _EXAMPLE)
        return first.is_(None) if isinstance(op, ast.Is) else first.is_not(None)
    if isinstance(op, ast.In | ast.NotIn):
        if not isinstance(right, ast.Tuple | ast.List):
            raise QueryError(f"'in' in the filter '{text}' needs a list in parentheses.", _EXAMPLE)
        values = [_operand_like(left, item, text) for item in right.elts]
        return first.in_(values) if isinstance(op, ast.In) else first.not_in(values)
    result: ColumnElement[bool] = _COMPARISONS[type(op)](first, _operand_like(left, right, text))
    return result


def _operand_like(other: ast.expr, node: ast.expr, text: str) -> SQLColumnExpression[Any]:
    """Check that operands can be compared, since databases also compare a word with a number."""
    operand = _operand(node, text)
    if _is_text(node) != _is_text(other):
        word, number = (node, other) if _is_text(node) else (other, node)
        raise QueryError(
            f"The filter '{text}' compares '{ast.unparse(word)}', which is text, with the number "
            f"'{ast.unparse(number)}'.",
            _EXAMPLE,
        )
    return operand


def _is_text(node: ast.expr) -> bool:
    """Whether an operand is a word or a text quantity."""
    if isinstance(node, ast.Name):
        return QUANTITY_BY_NAME[node.id].kind == "text"
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _operand(node: ast.expr, text: str) -> SQLColumnExpression[Any]:
    if isinstance(node, ast.Name):
        return _quantity(node.id, text)
    try:
        value = ast.literal_eval(node)
    except (TypeError, ValueError):  # the first that cannot be in a set
        value = None
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise QueryError(
            f"'{ast.unparse(node)}' in the filter '{text}' is neither quantity, number nor word.", _EXAMPLE
        )
    if isinstance(value, int) and abs(value) > LARGEST_SEED:  # larger whole numbers are compared as real numbers
        value = float(value) if abs(value) < sys.float_info.max else math.inf if value > 0 else -math.inf
    if isinstance(value, str) and not _storable(value):
        raise QueryError(f"{value!r} in the filter can't be in a database.", "Write plain characters.")
    return literal(value)


def _storable(word: str) -> bool:
    """Whether databases accept a text: no zero byte, no half of a surrogate pair."""
    return "\0" not in word and not any("\ud800" <= character <= "\udfff" for character in word)


def _quantity(name: str, text: str) -> SQLColumnExpression[Any]:
    if name in QUANTITY_BY_NAME:
        return EXPRESSIONS[name]
    close = difflib.get_close_matches(name, list(QUANTITY_BY_NAME), n=1)
    hint = f"Did you mean '{close[0]}'?" if close else f"Known are: {', '.join(QUANTITY_BY_NAME)}."
    raise QueryError(f"The filter '{text}' names the unknown quantity '{name}'.", hint)
