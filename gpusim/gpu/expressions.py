"""WGSL's constant expressions, evaluated on the host."""

from __future__ import annotations

import ast
import math
import operator
import re

from .packing import ShaderError

Scalar = bool | int | float

_OPERATORS = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.LShift: operator.lshift,
    ast.RShift: operator.rshift,
    ast.BitAnd: operator.and_,
    ast.BitOr: operator.or_,
    ast.BitXor: operator.xor,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}
_FUNCTIONS = {"u32": int, "i32": int, "f32": float, "min": min, "max": max, "abs": abs}
_SUFFIX = re.compile(r"(?<![\w.])(0[xX][0-9a-fA-F]+|(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)[uifh]\b")


class Names:
    """Module-scope constants by name, evaluated when asked for.

    Parameters
    ----------
    known : dict of str to number or str
        A str is a WGSL constant expression.
    """

    def __init__(self, known: dict[str, Scalar | str]) -> None:
        self._known = known

    def evaluate(self, expression: str) -> Scalar:
        """Evaluate a WGSL constant expression of numbers, names, + - * / % << >> & | ^.

        Raises
        ------
        ShaderError
            Anything else in the expression, or an unknown name.
        """
        plain = _SUFFIX.sub(r"\1", expression.strip())
        try:
            return self._node(ast.parse(plain, mode="eval").body)
        except (SyntaxError, ZeroDivisionError, RecursionError) as error:
            raise ShaderError(f"cannot evaluate {expression!r}: {error}") from error

    def _node(self, node: ast.expr) -> Scalar:
        match node:
            case ast.Constant(value=bool() | int() | float() as value):
                return value
            case ast.Name(id="true" | "false" as word):
                return word == "true"
            case ast.Name(id=name) if name in self._known:
                value = self._known[name]
                return self.evaluate(value) if isinstance(value, str) else value
            case ast.BinOp(left=left, op=ast.Div(), right=right):
                a, b = self._node(left), self._node(right)
                # WGSL divides integers toward zero (section "Arithmetic Expressions").
                return math.trunc(a / b) if isinstance(a, int) and isinstance(b, int) else a / b
            case ast.BinOp(left=left, op=ast.Mod(), right=right):
                a, b = self._node(left), self._node(right)
                return int(math.fmod(a, b)) if isinstance(a, int) else math.fmod(a, b)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](self._node(left), self._node(right))
            case ast.UnaryOp(op=op, operand=operand) if type(op) in _OPERATORS:
                return _OPERATORS[type(op)](self._node(operand))
            case ast.Call(func=ast.Name(id=name), args=args) if name in _FUNCTIONS:
                return _FUNCTIONS[name](*[self._node(argument) for argument in args])
        raise ShaderError(f"cannot evaluate {ast.unparse(node)!r} in a constant expression")
