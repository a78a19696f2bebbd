"""A closed-form expression: its size, simplification, constants and exports.

One tree is behind everything: prediction, the Python source, SymPy and LaTeX. Leaves are numbers
and named inputs; inner nodes are ``+ − × /`` (two arguments) and ``log`` (natural, one argument).

Size, counted one way everywhere: every operator, every number and every input is one node, so
``2.5*x + 1`` has five. Depth counts levels: a leaf has depth 1, ``2.5*x + 1`` depth 3. A weight in
front of an input is a multiplication and a number here, also where an engine counts it as nothing.
"""

from __future__ import annotations

import ast
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from keyword import iskeyword
from numbers import Real

import numpy as np

from foldlab.errors import InputError

BINARY = ("+", "-", "*", "/")
UNARY = ("log",)
OPERATORS = BINARY + UNARY

# A tree is a float, a str (an input) or a tuple (operator, argument, …).
Tree = float | str | tuple


def size(tree: Tree) -> int:
    """Number of nodes."""
    return 1 + sum(map(size, tree[1:])) if isinstance(tree, tuple) else 1


def depth(tree: Tree) -> int:
    """Number of levels; a leaf has one."""
    return 1 + max(map(depth, tree[1:])) if isinstance(tree, tuple) else 1


def operators(tree: Tree) -> set[str]:
    """The operators that occur."""
    if not isinstance(tree, tuple):
        return set()
    return {tree[0]}.union(*map(operators, tree[1:]))


def nests(tree: Tree, outer: str, inner: str) -> bool:
    """Whether ``inner`` occurs anywhere below an ``outer``."""
    if not isinstance(tree, tuple):
        return False
    if tree[0] == outer and any(inner in operators(a) for a in tree[1:]):
        return True
    return any(nests(a, outer, inner) for a in tree[1:])


def constants(tree: Tree) -> list[float]:
    """The numbers, left to right."""
    if isinstance(tree, tuple):
        return [c for a in tree[1:] for c in constants(a)]
    return [] if isinstance(tree, str) else [float(tree)]


def with_constants(tree: Tree, values: Sequence[float]) -> Tree:
    """The same tree with other numbers, in the order of :func:`constants`."""
    supply = iter(values)

    def fill(t):
        if isinstance(t, tuple):
            return (t[0], *map(fill, t[1:]))
        return t if isinstance(t, str) else float(next(supply))

    return fill(tree)


def with_names(tree: Tree, names: Sequence[str]) -> Tree:
    """The same tree with a name in place of each number, in the order of :func:`constants`."""
    supply = iter(names)

    def fill(t):
        if isinstance(t, tuple):
            return (t[0], *map(fill, t[1:]))
        return t if isinstance(t, str) else next(supply)

    return fill(tree)


def parsed(text: str, inputs: Sequence[str]) -> Tree:
    """Tree of an infix text such as ``(1.5e-3 * x) / log(y)``; the inverse of :func:`infix`.

    Raises :class:`InputError` for anything but numbers, the given inputs, + − * / and log.
    """
    binary = {ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/"}

    def build(node):
        match node:
            case ast.Constant(value=int() | float()):
                return float(node.value)
            case ast.Name(id=name) if name in inputs:
                return name
            case ast.UnaryOp(op=ast.UAdd()):
                return build(node.operand)
            case ast.UnaryOp(op=ast.USub()):
                inner = build(node.operand)
                return -inner if isinstance(inner, float) else ("*", -1.0, inner)
            case ast.BinOp() if type(node.op) in binary:
                return (binary[type(node.op)], build(node.left), build(node.right))
            case ast.Call(func=ast.Name(id=name), args=[argument], keywords=[]) if name in UNARY:
                return (name, build(argument))
        raise InputError(
            f"{ast.unparse(node)!r} in {text!r} is no formula here; "
            f"use numbers, {', '.join(inputs)}, + - * / and log"
        )

    try:
        return build(ast.parse(text, mode="eval").body)
    except SyntaxError:
        raise InputError(
            f"{text!r} is not an expression; write it in Python's infix form"
        ) from None


def infix(tree: Tree) -> str:
    """Python text; numbers with all digits of a double."""
    if isinstance(tree, str):
        return tree
    if not isinstance(tree, tuple):
        return repr(float(tree)) if tree >= 0 else f"({float(tree)!r})"
    if tree[0] in UNARY:
        return f"{tree[0]}({infix(tree[1])})"
    return f"({infix(tree[1])} {tree[0]} {infix(tree[2])})"


# Simplification. While they are collected, sums are {term: coefficient} and products
# (coefficient, {factor: power}); they are rebuilt as shallow as possible: depth is limited, too.


def simplified(tree: Tree) -> Tree:
    """An equivalent tree with numbers folded, weights merged and like terms collected.

    Equal wherever the given tree is finite, up to rounding; never drops a term. A tree in which a
    number overflows or is undefined on the way comes back unchanged.
    """
    try:
        short = _rebuild(_sum(tree))
    except (ZeroDivisionError, OverflowError, ValueError):
        return tree
    return short if all(map(math.isfinite, constants(short))) else tree


def _sum(tree) -> dict:
    """{coefficient-free tree or 1.0: coefficient}"""
    if isinstance(tree, tuple) and tree[0] in "+-":
        total = dict(_sum(tree[1]))
        sign = 1.0 if tree[0] == "+" else -1.0
        for term, c in _sum(tree[2]).items():
            total[term] = total.get(term, 0.0) + sign * c
        return {t: c for t, c in total.items() if c != 0} or {1.0: 0.0}
    if isinstance(tree, tuple) and tree[0] == "log":
        c, powers = _product(tree[1])
        if not powers:
            return {1.0: math.log(c)}
        # log(c x) = log c + log x holds for c > 0 only.
        inside = _product_tree(math.copysign(1.0, c), powers)
        return {("log", inside): 1.0, **({1.0: math.log(abs(c))} if abs(c) != 1 else {})}
    c, powers = _product(tree)
    if len(powers) == 1 and next(iter(powers.values())) == 1:
        (factor,) = powers
        if isinstance(factor, tuple) and factor[0] in "+-":
            return {t: c * v for t, v in _sum(factor).items()}
    return {_product_tree(1.0, powers) if powers else 1.0: c}


def _product(tree) -> tuple[float, dict]:
    """(coefficient, {factor: integer power})"""
    if isinstance(tree, tuple) and tree[0] in "*/":
        (c1, p1), (c2, p2) = _product(tree[1]), _product(tree[2])
        sign = 1 if tree[0] == "*" else -1
        powers = dict(p1)
        for factor, n in p2.items():
            powers[factor] = powers.get(factor, 0) + sign * n
        return c1 * c2 if sign == 1 else c1 / c2, {f: n for f, n in powers.items() if n}
    if isinstance(tree, tuple):
        terms = _sum(tree)
        if len(terms) == 1:
            ((term, c),) = terms.items()
            if term == 1.0:
                return c, {}
            if isinstance(term, tuple) and term[0] in "*/":
                inner, powers = _product(term)
                return c * inner, powers
            return c, {term: 1}
        # The weight of the first term moves out, where it merges with the others.
        lead = next(c for t, c in terms.items() if t != 1.0)
        return lead, {_rebuild({t: c / lead for t, c in terms.items()}): 1}
    return (1.0, {tree: 1}) if isinstance(tree, str) else (float(tree), {})


def _balanced(op: str, parts: list) -> Tree:
    parts = sorted(parts, key=depth)
    while len(parts) > 1:
        joined = (op, parts[0], parts[1])
        parts = sorted([*parts[2:], joined], key=depth)
    return parts[0]


def _product_tree(c: float, powers: dict) -> Tree:
    over = [f for f, n in powers.items() for _ in range(n)]
    under = [f for f, n in powers.items() for _ in range(-n)]
    if c != 1 or not over:
        over.append(float(c))
    top = _balanced("*", over)
    if not under:
        return top
    ways = [("/", top, _balanced("*", under))]
    if len(under) > 1:
        *rest, deepest = sorted(under, key=depth)
        ways.append(("/", ("/", top, _balanced("*", rest)), deepest))
    if len(over) > 1:
        *rest, deepest = sorted(over, key=depth)
        ways.append(("*", ("/", _balanced("*", rest), _balanced("*", under)), deepest))
    return min(ways, key=depth)


def _weighted(term, c: float) -> Tree:
    if term == 1.0:
        return float(c)
    if c == 1:
        return term
    return _product_tree(*(lambda k, p: (c * k, p))(*_product(term)))


def _rebuild(terms: dict) -> Tree:
    plus = [_weighted(t, c) for t, c in terms.items() if c > 0 or len(terms) == 1]
    minus = [_weighted(t, -c) for t, c in terms.items() if c < 0 and len(terms) > 1]
    if not plus:  # all negative: keep one sign inside, subtract the rest
        first, *rest = terms.items()
        plus, minus = [_weighted(*first)], [_weighted(t, -c) for t, c in rest]
    top = _balanced("+", plus)
    return ("-", top, _balanced("+", minus)) if minus else top


def _check(tree: Tree, inputs: Sequence[str]) -> None:
    """Raises :class:`InputError` for what is no :data:`Tree` of these inputs."""
    if isinstance(tree, tuple):
        count = {**dict.fromkeys(BINARY, 2), **dict.fromkeys(UNARY, 1)}
        name = tree[0] if tree and isinstance(tree[0], str) else None
        if len(tree) - 1 != count.get(name):
            raise InputError(f"{tree!r:.80} in a formula; expected {' '.join(OPERATORS)}")
        for part in tree[1:]:
            _check(part, inputs)
    elif tree not in inputs if isinstance(tree, str) else not isinstance(tree, Real):
        raise InputError(
            f"{tree!r:.80} in a formula; expected a number or one of {', '.join(inputs)}"
        )


@dataclass(frozen=True)
class Formula:
    """``y = tree(inputs)``, evaluated in double precision.

    ``inputs`` names the columns in order. Calling it with an array of shape (n, inputs) gives
    (n,) values; nothing is protected, so a logarithm of a negative number is NaN. Raises
    :class:`InputError` for another shape, where a number in the tree is not finite, and for a tree
    of anything but operators, numbers and the inputs: its source is run as Python.
    """

    tree: Tree
    inputs: tuple[str, ...]

    def __post_init__(self):
        if not all(
            isinstance(n, str) and n.isidentifier() and not iskeyword(n) for n in self.inputs
        ):
            raise InputError(f"the inputs {self.inputs!r} of a formula; expected names of columns")
        _check(self.tree, self.inputs)
        if not np.isfinite(constants(self.tree)).all():
            raise InputError(
                f"the formula {infix(self.tree)} holds a number that is not finite; give finite"
            )

    def __reduce__(self):
        return Formula, (self.tree, self.inputs)  # the compiled function stays behind

    @property
    def size(self) -> int:
        return size(self.tree)

    @property
    def depth(self) -> int:
        return depth(self.tree)

    def __str__(self) -> str:
        return infix(self.tree)

    def python(self, name: str = "formula") -> str:
        """Source of a stand-alone NumPy function of the inputs; all digits of a double."""
        body = infix(self.tree)
        lines = ["from numpy import log"] if "log" in operators(self.tree) else []
        lines += ["", ""] if lines else []
        lines += [f"def {name}({', '.join(self.inputs)}):", f"    return {body}"]
        return "\n".join(lines) + "\n"

    @cached_property
    def function(self):
        """The exported source, compiled: ``function(*inputs)``."""
        scope: dict = {}
        exec(compile(self.python(), "<formula>", "exec"), scope)
        return scope["formula"]

    def __call__(self, X) -> np.ndarray:
        X = np.asarray(X, dtype=float)
        if X.ndim != 2 or X.shape[1] != len(self.inputs):
            raise InputError(
                f"the formula takes {len(self.inputs)} columns ({', '.join(self.inputs)}); "
                f"got shape {X.shape}: give one row per design"
            )
        with np.errstate(all="ignore"):
            values = self.function(*X.T)
        return np.broadcast_to(np.asarray(values, dtype=float), (len(X),)).copy()

    def sympy(self):
        """The same expression as a SymPy object; the inputs become positive symbols."""
        import sympy

        symbols = {n: sympy.Symbol(n, positive=True) for n in self.inputs}

        def build(t):
            if isinstance(t, str):
                return symbols[t]
            if not isinstance(t, tuple):
                return sympy.Float(repr(float(t)), 17)
            args = [build(a) for a in t[1:]]
            match t[0]:
                case "+":
                    return args[0] + args[1]
                case "-":
                    return args[0] - args[1]
                case "*":
                    return args[0] * args[1]
                case "/":
                    return args[0] / args[1]
            return sympy.log(args[0])

        return build(self.tree)

    def latex(self, symbols: dict[str, str] | None = None, digits: int = 9) -> str:
        """LaTeX text; ``symbols`` maps inputs to LaTeX names, numbers carry ``digits`` digits."""
        import sympy

        expr = self.sympy()
        named = {s: (symbols or {}).get(s.name) for s in expr.free_symbols}
        named = {s: text for s, text in named.items() if text}
        return sympy.latex(sympy.N(expr, digits), symbol_names=named)
