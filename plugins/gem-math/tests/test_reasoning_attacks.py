"""An answer runs no code, holds nothing up, and harms no episode but its own: tried on the scorer of every task."""

from __future__ import annotations

import ast
import importlib.util
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

import gem_core as gem
from gem_math.reasoning.listing import TASKS
from gem_math.reasoning.mending import READ_AS_FORMULAS, READ_AS_LITERALS, formula, literal

pytest.importorskip("reasoning_gym", reason="rg:* needs gem-math[reasoning-gym], which needs a C compiler")
pytestmark = pytest.mark.thorough

READERS = {"eval", "exec", "parse_expr", "sympify", "compile", "__import__", "literal_eval", "loads", "system", "Popen"}
# What each of these reads is the library's own, or JSON.
HARMLESS = """algorithmic.game_of_life loads|algorithmic.graph_color loads|algorithmic.group_anagrams loads
    |algorithmic.jugs loads|algorithmic.number_sorting loads|algorithmic.palindrome_partitioning loads
    |arithmetic.basic_arithmetic eval|arithmetic.bitwise_arithmetic eval|code.bf compile|code.codeio exec
    |arithmetic.gsm_symbolic.generators_00_49 eval|arithmetic.gsm_symbolic.generators_50_99 eval|code.codeio loads
    |cognition.figlet_fonts loads|cognition.rubiks_cube compile|games.boxnet loads|games.countdown compile
    |games.knight_swap loads|logic.propositional_logic parse_expr"""


def attacks(flag: Path) -> list[str]:
    """Return answers that make a file where they are evaluated, or keep a scorer busy."""
    code = f"__import__('pathlib').Path({str(flag)!r}).touch()"
    return [
        code, f"[{code}]", f"[[{code}]]", f"({code}, 1)[1]", f"[x for x in [{code}]]", f"(lambda: {code})()",
        f"Symbol('x') + {code}", f"x + S({code!r})", f"sympify({code!r})", f"f'{{{code}}}'", f'{{"a": "{code}"}}',
        f"().__class__.__base__.__subclasses__() or {code}", f"print(open({str(flag)!r}, 'w'))",
        "9**9**9**9", "10**(10**9)", "1e999999999/7", "1E+999999999999", "nan", "[" * 10_000, "9" * 5_000, "-" * 30_000,
        "(" * 10_000 + "1" + ")" * 10_000, "A+999999999999 A-999999999999", "a,b;" * 9_000, "\ud800\x00",
        "[[]]", "[{}]", "Move disk 1 from Peg 1 to Peg 2\n" * 1_000, "null", '{"0": null}', "=" * 20_000, "¬" * 20_000,
        "((P ∧ Q) → " * 1_000, "F " * 15_000,
    ]  # fmt: skip


@pytest.mark.parametrize("name", TASKS)
def test_no_answer_runs_code_or_goes_unscored(name: str, tmp_path: Path) -> None:
    """Each is scored, at the agent's expense, and the scorer goes on as before."""
    flag = tmp_path / "ran"
    env = gem.make(f"rg:{name}", time_limit_s=0.5)
    for answer in attacks(flag):
        env.reset(options={"index": 0})
        _, reward, terminated, truncated, info = env.step(f"<answer>{answer}</answer>")
        assert 0.0 <= reward <= 1.0, answer[:50]
        assert (terminated, truncated) == (True, False), (answer[:50], info)
        assert "error" not in info, answer[:50]
    assert not flag.exists()
    env.reset(options={"index": 0})
    right = env.unwrapped.present_row()["answer"]
    if right is not None:
        assert env.step(f"<answer>{right}</answer>")[1] == 1.0


def test_every_reader_of_text_in_the_library_is_known() -> None:
    """A release that evaluates answers somewhere else is found here."""
    spec = importlib.util.find_spec("reasoning_gym")
    assert spec is not None
    assert spec.origin is not None
    root = Path(spec.origin).parent
    found = set()
    for path in root.rglob("*.py"):
        module = ".".join(path.relative_to(root).with_suffix("").parts)
        if "contrib" in module or module.startswith(("coaching", "composite")):
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Call):
                called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
                if called in READERS:
                    found.add((module, called))
    mended = {(module, "eval") for module in READ_AS_LITERALS}
    mended |= {(module, "parse_expr") for module in READ_AS_FORMULAS}
    assert found == mended | {(module, called) for module, called in map(str.split, HARMLESS.split("|"))}


@pytest.mark.parametrize(
    "text",
    ["x.free_symbols", "x['a']", "'x'", "S(1)", "Function(x)", "__name__", "x if x else y", "lambda: x", "x; y",
     "x := 1", "2**3**99", "x**99999", "x" * 4_001, "x^2", "[x]", ""],
)  # fmt: skip
def test_a_formula_has_nothing_but_arithmetic_in_it(text: str) -> None:
    """Neither attributes nor strings, nor names of anything but variables and elementary functions."""
    with pytest.raises(ValueError, match=r"formula|exponent"):
        formula(text)


def test_a_formula_is_what_sympy_makes_of_it() -> None:
    """Where it has nothing else in it."""
    import sympy

    for text in ("2*x**2 - x/3 + sin(x)", "log(x + 1)*exp(-x)", "1.5e3 + sqrt(2)", "x**(1/2)", "(5 - 3)*7"):
        assert formula(text) == sympy.parse_expr(text)


@given(st.text(alphabet="xS1290.+-*/()e, sinlog_[]'\"", max_size=30))
def test_any_text_is_a_formula_or_a_value_error(text: str) -> None:
    """Or what sympy itself raises for a formula without sense; in bounded time."""
    try:
        formula(text)
    except (ValueError, TypeError, SyntaxError, AttributeError, ArithmeticError, RecursionError):
        assert True


@given(st.recursive(st.none() | st.integers() | st.text(), lambda inner: st.lists(inner) | st.tuples(inner, inner)))
def test_a_literal_is_read_back(value: object) -> None:
    """As ``eval`` would."""
    assert literal(repr(value)) == value


@pytest.mark.parametrize(
    ("task", "answers"),
    [
        ("game_of_life_halting", ["maybe", "True or False", "0"]),
        ("puzzle24", ["1*(8 + 8 + 8)", "24 + 1 - 1 + 0", "6*4*1*1"]),
        ("complex_arithmetic", ["nan", "nan + 1i", "NaN"]),
        ("coin_flip", ["0", "0.", "-0"]),
    ],
)
def test_scorers_that_took_wrong_answers_are_mended(task: str, answers: list[str]) -> None:
    """What the library gives 1 to on some row or all, and must not; the row's own answer still has it."""
    env = gem.make(f"rg:{task}", size=40)
    for index in range(8):
        env.reset(seed=0, options={"index": index})
        gold = env.gold_action()
        assert env.step(gold)[1] == 1.0
        for answer in answers:
            boxed = f"\\boxed{{{answer}}}"
            env.reset(seed=0, options={"index": index})
            assert env.step(boxed)[1] < 1.0 or boxed == gold
