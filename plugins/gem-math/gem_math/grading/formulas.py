r"""Compares formulas, and sets of numbers that these describe.

Formulas are read by math-verify's grammar into sympy's trees, and evaluated to 50 digits at several points.

Runs in the processes of the pool alone, since any of it may take forever. Doubles, and NumPy with them, would be faster
and cannot tell x^2 + 10^{-17} from x^2; reading takes ten times as long as either.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Iterable, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import Any

import mpmath  # type: ignore[import-untyped]  # none of these packages has types
import sympy  # type: ignore[import-untyped]
from latex2sympy2_extended import latex2sympy  # type: ignore[import-untyped]
from latex2sympy2_extended.latex2sympy2 import ConversionConfig  # type: ignore[import-untyped]
from latex2sympy2_extended.math_normalization import (  # type: ignore[import-untyped]
    NormalizationConfig,
    normalize_latex,
)
from math_verify import verify  # type: ignore[import-untyped]
from sympy.core.function import AppliedUndef  # type: ignore[import-untyped]

from gem_math.grading.forms import Form, Inequality, Parts
from gem_math.grading.quantities import Leaf

_DIGITS = mpmath.mp.dps = 50
_EQUAL = mpmath.mpf(10) ** -35
_NEAR, _FAR, _WHOLE = range(4), range(4, 10), range(64)
_UNFINISHED = (sympy.Sum, sympy.Product, sympy.Integral, sympy.Limit, sympy.Derivative)
_WHOLE_ONLY = (sympy.factorial, sympy.binomial, sympy.floor, sympy.ceiling)
_INTERVALS = {"()", "[)", "(]", "[]"}
_RELATIONS = {"<": sympy.Lt, ">": sympy.Gt, "<=": sympy.Le, ">=": sympy.Ge, "!=": sympy.Ne}
_UNDEFINED = (sympy.nan, sympy.zoo)
_NO_NUMBER = (*_UNFINISHED, AppliedUndef, sympy.oo, -sympy.oo)

_MATRICES = NormalizationConfig(
    basic_latex=True, units=False, malformed_operators=False, nits=False, boxed="none", equations=False
)
# What the grammar would read wrongly: 5 3 as 8, x' as x; or has no sign of mathematics.
_MISREAD = re.compile(
    r"(?<!_)\d\s+[\d.]|(?<![\d_^c])\d+\s*\{\s*\d|\\frac\s*\{[^{}]*\}\d{2}|[^\x20-\x7e]|[\"#;@?`]|__|\\ldots|\\text"
    r"|\^\s*\{?\s*T(?![a-zA-Z_])|\|\s*\\begin"
)
_DECIMAL = re.compile(r"(\d*)\.(\d+)")
_ARGUMENTS = [
    (re.compile(r"\\(frac|binom)\s*([\da-zA-Z]|\\pi(?![a-zA-Z]))"), r"\\\1{\2}"),
    (re.compile(r"(\\(?:frac|binom)\s*\{(?:[^{}]|\{[^{}]*\})*\})\s*([\da-zA-Z]|\\pi(?![a-zA-Z]))"), r"\1{\2} "),
    (re.compile(r"\\sqrt\s*(\[[^\]]*\])?\s*([\da-zA-Z]|\\pi(?![a-zA-Z]))"), r"\\sqrt\1{\2} "),
    (re.compile(r"\\sqrt\s*\(([^()]*)\)"), r"\\sqrt{\1}"),
    (re.compile(r"\^\s*([-+]?)\s*(\\frac\{[^{}]*\}\{[^{}]*\}|\\[a-zA-Z]+|[a-zA-Z]|\d*\.?\d+)"), r"^{\1\2}"),
    (re.compile(r"\^\s*\(((?:[^()]|\([^()]*\))*)\)"), r"^{(\1)}"),
    (re.compile(r"(?<![\w.)}])(\d+)\s*/\s*(\d+)\s*(?=[a-zA-Z\\(])"), r"\\frac{\1}{\2}"),
    (re.compile(r"\\?%"), r"\\cdot\\frac{1}{100}"),
    (re.compile(r"\\lg(?![a-zA-Z])"), r"\\log_{10}"),
    (re.compile(r"\\cosec(?![a-zA-Z])"), r"\\csc"),
    (re.compile(r"(\d+(?:\.\d+)?|[a-zA-Z]|\([^()]*\))\s*\^\{?\s*\\circ\s*\}?"), r"(\1\\cdot\\frac{\\pi}{180})"),
]
_GREEK = (
    r"\\(?:alpha|beta|gamma|delta|theta|lambda|mu|phi|omega|sigma|tau|rho|epsilon|zeta|eta|kappa|nu|xi|chi|psi"
    r"|Gamma|Delta|Theta|Lambda|Phi|Omega|Sigma|Psi|Xi)(?![a-zA-Z])"
)
_ATOM = rf"\s*-?\s*(?:[\d.]+|{_GREEK}|\\(?:pi|infty)(?![a-zA-Z])|[a-zA-Z](?:_\s*\{{\w+\}})?)\s*"
# A letter with its index and primes; and what else has letters, with its index: that is no name. Behind a name may
# stand what a function is applied to, which a power of -1 is not.
_NAME = re.compile(
    rf"(?P<name>{_GREEK}|(?<!\\)[a-zA-Z])\s*(?:_\s*\{{(?P<index>[^{{}}]*)\}})?(?P<primes>'*)"
    rf"(?P<inverse>\^\s*\{{\s*-\s*1\s*\}}(?=\({_ATOM}\)))?"
    rf"(?P<bracket>\s*(?=\()(?P<applied>(?!\(\s*-\s*1\s*\)\s*\^)(?=\({_ATOM}(?:,{_ATOM})*\)))?)?"
    r"|\\(?:begin|end)\s*\{[a-z]+\}|\\[a-zA-Z]+(?:\s*_\s*\{[^{}]*\})?"
)
# A number or a bracket before a bracket is a factor: the grammar takes 2(3) for 5.
_FACTOR = re.compile(r"((?<![\d_^.])\d[\d.]*|\\pi(?![a-zA-Z])|\))\s*(?=\()|\)\s*(?=\d)")
_LETTER = re.compile(r"\\(?:begin|end)\s*\{[a-z]+\}|\\[a-zA-Z]+|q_\{\w+\}|[iI](?!\s*_)")
_CONSTANT = re.compile(r"^(q_\{)?c(?=\d*\}?$)")
_AMBIGUOUS_LOG = re.compile(r"\\log(?!\s*_)")


def same(gold: str, answer: str) -> bool:
    """Return whether two formulas are the same; a logarithm without a base may be that to the base 10 or e.

    Raises:
        Exception: Of any kind, where one of them cannot be read.
    """
    bases = (False, True) if _AMBIGUOUS_LOG.search(gold + answer) else (False,)
    functions = functions_in(gold, answer)
    return any(_same(parse(gold, base, functions), parse(answer, base, functions)) for base in bases)


def functions_in(gold: str, *others: str) -> frozenset[str]:
    """Return the names that are functions: applied to numbers and names alone, as f(0), and never alone in the gold."""
    names = [(_spelled(match), match) for text in (gold, *others) for match in _NAME.finditer(text) if match["name"]]
    alone = {_spelled(match) for match in _NAME.finditer(gold) if match["name"] and match["bracket"] is None}
    return frozenset(name for name, match in names if match["applied"] is not None) - alone - {"e", "i"}


@lru_cache(maxsize=2000)  # a gold answer is compared with many answers
def parse(text: str, natural_log: bool = False, functions: frozenset[str] | None = None) -> Any:
    """Return sympy's tree of a formula, whose ``functions`` are those of another as well.

    Raises:
        Exception: Of any kind, where it cannot be read or has no value.
    """
    if _MISREAD.search(text):
        raise ValueError(f"there is no formula in {text!r:.80}")
    functions = functions_in(text) if functions is None else functions
    text = _prepared(_AMBIGUOUS_LOG.sub(r"\\ln", text) if natural_log else text, functions)
    tree = latex2sympy(
        text,
        is_real=True,
        convert_degrees=False,
        normalization_config=None,
        conversion_config=ConversionConfig(lowercase_symbols=False),
    )
    if not isinstance(tree, sympy.Expr):
        return tree
    tree = tree.doit().replace(_is_odd_root, lambda root: _sign(root) * (-root.base) ** root.exp)
    if tree.has(*_UNDEFINED):
        raise ValueError(f"{text!r:.80} has no value")
    return tree


def _spelled(match: re.Match[str]) -> str:
    """Return a name as the grammar is given it: one with an index or primes as q_{…}, since E_1 is none to it."""
    name, index, primes, inverse = match.group("name", "index", "primes", "inverse")
    if index is None and not primes and inverse is None:
        return name
    index = re.sub(r"\W", lambda sign: f"u{ord(sign[0])}", re.sub(r"\s", "", index or ""))
    return f"q_{{{name.lstrip(chr(92))}{index}{'prime' * len(primes)}{'inverse' if inverse else ''}}}"


def _prepared(text: str, functions: frozenset[str]) -> str:
    if r"\begin" in text:
        text = normalize_latex(text, _MATRICES)

    def name(match: re.Match[str]) -> str:
        if not match["name"]:
            return match[0]
        spelled = _spelled(match)
        factor = match["bracket"] is not None and spelled not in functions
        return spelled + (r"\cdot " if factor else " " if spelled[0] == "\\" else "")

    text = _NAME.sub(name, text)
    if "'" in text:
        raise ValueError("there are primes behind what is no name")
    for pattern, replacement in _ARGUMENTS:
        text = pattern.sub(replacement, text)
    # Exact fractions instead of floats.
    text = _DECIMAL.sub(lambda match: rf"(\frac{{{int(match[1] + match[2])}}}{{{10 ** len(match[2])}}})", text)
    text = _FACTOR.sub(r"\g<0>\\cdot ", text)
    # The index of a sum is not the imaginary unit.
    if re.search(r"_\s*\{?\s*i\s*=", text):
        return text
    return _LETTER.sub(lambda match: {"i": "(I)", "I": r"\iota "}.get(match[0], match[0]), text)


def _is_odd_root(tree: Any) -> bool:
    """Whether a tree is the root of a negative number that is real at school, as that of -8 to the base 3."""
    return bool(tree.is_Pow and tree.exp.is_Rational and tree.exp.q % 2 and tree.exp.q > 1 and tree.base.is_negative)


def _sign(root: Any) -> int:
    return -1 if root.exp.p % 2 else 1


def value(text: str) -> Any:
    """Return the value of a formula without letters, as sympy's number; None of any other."""
    try:
        tree = parse(text)
    except Exception:  # noqa: BLE001  # the grammar and sympy raise whatever
        return None
    if not isinstance(tree, sympy.Expr) or tree.free_symbols or tree.has(*_NO_NUMBER):
        return None
    return tree if tree.is_Rational else tree.evalf(_DIGITS)


def contradict(step: str, last: str, places: int | None) -> bool:
    """Return whether two numbers differ, the last of which may be rounded to some decimal places: x = 1/3 = 0.33."""
    first, second = value(step), value(last)
    if first is None or second is None:
        return False
    return places is None or not bool(abs(first - second) < sympy.Rational(1, 10**places))


def rounds_to(text: str, decimal: str, places: int) -> bool | None:
    """Return whether a number without an end as a decimal has these places; None of any other number or formula."""
    number = value(text)
    if number is None or (number.is_Rational and not set(sympy.primefactors(number.q)) - {2, 5}):
        return None
    # Zeros in front tell nothing: 0.000001 is no third of it.
    if not number.is_real or len(decimal.lstrip("+-").replace(".", "").lstrip("0")) < 6:
        return False
    return bool(abs(number - sympy.Rational(decimal)) <= sympy.Rational(1, 10**places))


def same_equation(gold: tuple[str, str], answer: tuple[str, str]) -> bool:
    """Return whether two equations, each with its two sides, are the same: turned, moved and multiplied."""
    functions = functions_in(" = ".join(gold), *answer)
    one, other = (parse(left, False, functions) - parse(right, False, functions) for left, right in (gold, answer))
    # x = 5 and y = 5 have nothing to do with each other, and 5 = 5 says nothing.
    if one.free_symbols != other.free_symbols or not one.free_symbols:
        return False
    return ratio(one, other) is not None


def same_progression(gold: str, answer: str, letter: str) -> bool:
    r"""Return whether two formulas a + pk have the same values for whole k, as \pi k and \pi(k + 1)."""
    index = sympy.Symbol(letter, real=True)
    trees = [parse(gold), parse(answer)]
    (start, other_start), (step, other_step) = [[f(tree) for tree in trees] for f in (_at_zero(index), _step(index))]
    if step.is_zero or any(tree.free_symbols for tree in (start, other_start, step, other_step)):
        return False
    shift = (other_start - start) / step
    return _is_zero(shift - sympy.Integer(round(shift.evalf()))) and _is_zero(step**2 - other_step**2)


def _at_zero(index: Any) -> Any:
    return lambda tree: tree.subs(index, 0)


def _step(index: Any) -> Any:
    return lambda tree: tree.diff(index).expand()


def _is_zero(number: Any) -> bool:
    return _vanishes(number) is True


def _same(one: Any, other: Any) -> bool:
    other = _with_constant(one, other)
    if one == other:
        return True
    trees = (one, other)
    if any(getattr(tree, "is_Matrix", False) for tree in trees):
        return bool(sympy.ImmutableMatrix(one.doit()) == sympy.ImmutableMatrix(other.doit()))
    if all(isinstance(tree, sympy.Expr) for tree in trees):
        if any(tree.has(sympy.oo, -sympy.oo) for tree in trees):
            return False
        if (verdict := _vanishes(one - other)) is not None:
            return verdict
    return bool(verify(one, other, timeout_seconds=None, raise_on_error=True))


def _with_constant(gold: Any, answer: Any) -> Any:
    """Return an answer with the gold's spelling of a constant of integration, c or C: both are linear in it."""
    ours, theirs = gold.free_symbols - answer.free_symbols, answer.free_symbols - gold.free_symbols
    others = {letter.name for letter in gold.free_symbols - ours}
    if not others or others & set("abAB"):  # of a triangle, c and C are two things
        return answer
    spelled = {_CONSTANT.sub(r"\1C", letter.name): letter for letter in ours}
    for letter in theirs:
        own = spelled.get(_CONSTANT.sub(r"\1C", letter.name))
        if own is not None and not gold.diff(own, 2) and not answer.diff(letter, 2):
            answer = answer.xreplace({letter: own})
    return answer


def _vanishes(difference: Any) -> bool | None:
    """Return whether a formula is zero at all points; None where that is not told."""
    if difference.has(*_UNFINISHED):
        return None
    verdicts = _zeros(difference, _points_for(difference))
    # The letters of logarithms are positive, so that \ln(xy) is \ln x + \ln y.
    if len(set(verdicts)) > 1 and difference.has(sympy.log) and not difference.has(sympy.Abs, sympy.floor):
        verdicts = _zeros(difference, [(point, False) for point in (0, 2, 3, 4)])
    if len(verdicts) < (2 if difference.free_symbols else 1):
        return None
    return all(verdicts)


def _zeros(difference: Any, points: Sequence[tuple[int, bool]]) -> list[bool]:
    """Return at which points, of those where a formula has a value, it is zero beside its largest term."""
    letters = sorted(difference.free_symbols, key=str)
    values = _values(sympy.Add.make_args(difference), letters, points)
    return [bool(abs(mpmath.fsum(terms)) <= _EQUAL * max(map(abs, terms))) for terms in values]


def _points_for(tree: Any) -> list[tuple[int, bool]]:
    """Return the points that tell a formula from others, each with whether its letters are whole numbers."""
    if not tree.free_symbols:
        return [(0, False)]
    near = [(point, False) for point in _NEAR]
    if tree.has(*_WHOLE_ONLY):
        # The floor of what is whole at each whole number only says something between them.
        idle = not tree.has(sympy.factorial, sympy.binomial) and any(map(_is_idle, tree.atoms(*_WHOLE_ONLY[2:])))
        return [(point, True) for point in _WHOLE] + (near if idle else [])
    # Absolute values and roots may agree with something else nearby.
    pieces = tree.has(sympy.Abs, sympy.log, sympy.asin, sympy.acos, sympy.atan) or any(
        not power.exp.is_integer and power.base.free_symbols for power in tree.atoms(sympy.Pow)
    )
    return near + [(point, False) for point in _FAR if pieces]


def _is_idle(floor: Any) -> bool:
    """Whether what is rounded is a whole number wherever the letters are."""
    whole = {letter: sympy.Symbol(letter.name, integer=True) for letter in floor.free_symbols}
    return bool(whole) and floor.args[0].xreplace(whole).is_integer is True


def ratio(one: Any, other: Any) -> Any:
    """Return the constant factor between two formulas; None where there is none."""
    letters = sorted(one.free_symbols | other.free_symbols, key=str)
    whole = one.has(*_WHOLE_ONLY) or other.has(*_WHOLE_ONLY)
    pairs = _values((one, other), letters, [(point, whole) for point in (*_NEAR, *_FAR)])
    ratios = [first / second for first, second in pairs if first and second]
    if len(ratios) < max(2, len(pairs) - 1):
        return None
    return ratios[0] if all(abs(ratio - ratios[0]) <= _EQUAL * abs(ratios[0]) for ratio in ratios) else None


def _values(trees: Iterable[Any], letters: Sequence[Any], points: Iterable[tuple[int, bool]]) -> list[list[Any]]:
    """Return the values of formulas at each point where all of them have one."""
    # With letters of our own, so that no text of an answer stands in what lambdify compiles.
    dummies = [sympy.Dummy() for _ in letters]
    renamed = [
        tree.xreplace(dict(zip(letters, dummies, strict=True))).replace(_is_applied, _stand_in) for tree in trees
    ]
    found = []
    evaluate = sympy.lambdify(dummies, renamed, modules="mpmath")
    for point, whole in points:
        try:
            values = evaluate(*(_letter_value(letter.name, point, whole) for letter in letters))
        except (ZeroDivisionError, ValueError, OverflowError):
            continue
        if all(mpmath.isfinite(value) for value in values):
            found.append(values)
    return found


def _is_applied(tree: Any) -> bool:
    return isinstance(tree, AppliedUndef)


def _stand_in(tree: Any) -> Any:
    """Return some function of the arguments, that the name of an unknown one decides, so that it can be evaluated."""
    seed = zlib.crc32(type(tree).__name__.encode())
    shifts = [(place + 1 + (seed >> place) % 97) * argument for place, argument in enumerate(tree.args)]
    return sympy.cos(sympy.Add(sympy.Rational(seed % 7919, 1009), *shifts) / 53) + 2


def _letter_value(name: str, point: int, whole: bool) -> Any:
    """Return a value that depends on the name and the point alone: positive, negative, large, small; or whole."""
    seed = zlib.crc32(f"{name}#{point}".encode())
    if whole:
        return mpmath.mpf(3 + (seed % 29) * 2 + point % 2 + (point // 4) * (seed >> 8) % 5)
    if point in _FAR:
        return mpmath.mpf((30 + seed % 37) * 20 ** ((point - 4) // 2)) * (-1) ** point
    number = mpmath.mpf(101 + seed % 7919) / (1009 + (seed >> 13) % 3001)
    return -number if point == 1 else number + 3 * (point == 2)


def same_conditions(gold: Form, answer: Form, name: str) -> bool:
    """Return whether inequalities, or an interval of ``name``, say the same: each is a positive multiple of another's.

    Raises:
        Exception: Of any kind, where a formula cannot be read.
    """
    golds, left = _conditions(gold, name), _conditions(answer, name)
    if not golds or len(golds) != len(left):
        return False
    for tree, strict in golds:
        fit = (
            index
            for index, (other, other_strict) in enumerate(left)
            if strict == other_strict and (factor := ratio(tree, other)) is not None and factor.real > 0
        )
        found = next(fit, None)
        if found is None or not tree.free_symbols:
            return False
        del left[found]
    return True


def _conditions(form: Form, name: str) -> list[tuple[Any, bool]]:
    """Return formulas that are more than zero, and whether each is never zero; none of what says more, or less."""
    pairs: list[tuple[str, str, bool]] = []
    if isinstance(form, Inequality) and set(form.signs) <= {"<", ">", "<=", ">="}:
        for sides, sign in zip(pairwise(form.sides), form.signs, strict=True):
            more, less = sides if sign[0] == ">" else sides[::-1]
            pairs.append((more, less, len(sign) == 1))
    elif name and (ends := _ends(form)) is not None:
        (low, low_open), (high, high_open) = ends
        pairs += [] if "infty" in low else [(name, low, low_open)]
        pairs += [] if "infty" in high else [(high, name, high_open)]
    return [(parse(more) - parse(less), strict) for more, less, strict in pairs]


def _ends(form: Form) -> tuple[tuple[str, bool], tuple[str, bool]] | None:
    """Return the ends of an interval, each with whether it is left out; None of anything else."""
    if not isinstance(form, Parts) or form.kind not in _INTERVALS or len(form.items) != 2:
        return None
    low, high = form.items
    if not isinstance(low, Leaf) or not isinstance(high, Leaf):
        return None
    return (low.text, form.kind[0] == "("), (high.text, form.kind[1] == ")")


def same_sets(gold: Form, answer: Form) -> bool:
    """Return whether two forms are the same set of numbers, of the same letter if both name one.

    Raises:
        Exception: Of any kind, where a formula cannot be read, or a set is too hard.
    """
    (name, one), (other_name, other) = _set_of(gold), _set_of(answer)
    if sympy.S.EmptySet in {one, other} or (name and other_name and name != other_name):
        return False
    return bool(one == other or one.symmetric_difference(other) is sympy.S.EmptySet)


def _set_of(form: Form) -> tuple[str, Any]:
    """Return the letter of which a form says where it lies, if it names one, and the set; empty of anything else."""
    if isinstance(form, Inequality):
        return _set_of_letter(form)
    if (ends := _ends(form)) is not None:
        (low, low_open), (high, high_open) = ends
        closed_at_infinity = ("infty" in low and not low_open) or ("infty" in high and not high_open)
        found = sympy.Interval(parse(low), parse(high), low_open, high_open)
        return "", sympy.S.EmptySet if closed_at_infinity else found
    if not isinstance(form, Parts):
        return "", sympy.S.EmptySet
    if form.kind == "set":
        return "", sympy.FiniteSet(*(parse(item.text) for item in form.items if isinstance(item, Leaf)))
    names, sets = zip(*map(_set_of, form.items), strict=True)
    if form.kind not in {"list", "or", "union"} or sympy.S.EmptySet in sets or len(set(names)) != 1:
        return "", sympy.S.EmptySet
    # x < 1, x > 3 is one or the other, and x > 1, x < 3 both.
    both = sympy.Intersection(*sets)
    return names[0], both if form.kind == "list" and names[0] and both is not sympy.S.EmptySet else sympy.Union(*sets)


def _set_of_letter(form: Inequality) -> tuple[str, Any]:
    """Return the one letter of inequalities that all hold, and the set of its values; empty where there are more."""
    pairs = (
        list(pairwise(form.sides)) if set(form.signs) != {"!="} else [(form.sides[0], side) for side in form.sides[1:]]
    )
    trees = [(parse(left), sign, parse(right)) for (left, right), sign in zip(pairs, form.signs, strict=True)]
    letters = {letter for left, _, right in trees for letter in (left - right).free_symbols}
    if len(letters) != 1:
        return "", sympy.S.EmptySet
    return str(letters.pop()), sympy.And(*(_RELATIONS[sign](left, right) for left, sign, right in trees)).as_set()
