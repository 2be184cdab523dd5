"""Environments with a planted defect each, and sound ones, as authors write them."""

from __future__ import annotations

import base64
import codecs
import random
import re
import subprocess
from typing import Any, ClassVar

from careless_graders import (
    accepts_nothing,
    boxed,
    compares_by_distance,
    evaluates,
    evaluates_in_its_scope,
    grader,
    judged_by_prompt,
    matches_a_pattern,
    run_and_exit,
    run_in_the_grader,
    verdict,
)

import gem_core as gem
from gem_core.data import Grade

CAPITALS = {
    "France": "Paris", "Italy": "Rome", "Spain": "Madrid", "Japan": "Tokyo", "Egypt": "Cairo", "Peru": "Lima",
    "Kenya": "Nairobi", "Norway": "Oslo", "Cuba": "Havana", "Iran": "Tehran", "Iraq": "Baghdad", "Chile": "Santiago",
    "Ghana": "Accra", "Greece": "Athens", "Nepal": "Kathmandu", "Poland": "Warsaw", "Sweden": "Stockholm",
    "Turkey": "Ankara", "Vietnam": "Hanoi", "Qatar": "Doha",
}  # fmt: skip
ROWS = [
    {"question": f"What is the capital of {country}? Answer in \\boxed{{}}.", "answer": capital}
    for country, capital in CAPITALS.items()
]
SUMS = [{"question": f"What is {a} + {a * 3 % 17}?", "answer": str(a + a * 3 % 17)} for a in range(3, 43)]

CODE_ROWS = [
    {
        "question": f"Task {n}: write double(x) in a ```python block.",
        "answer": "```python\ndef double(x): return 2*x\n```",
    }
    for n in range(4)
]


class CodeRows(gem.DatasetEnv):
    """Rows whose answers are programs."""

    def gold_response(self, row: Any) -> str:
        """Return the program."""
        return str(row["answer"])


class Duel(gem.Env):
    """Two turns against an opponent who loses half of the time, whatever is said; nobody knows a solution."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Begin."""
        super().reset(seed=seed)
        self.turns, self.wins = 0, bool(self.np_random.integers(2))
        return "Say fact or lie in \\boxed{}.", {}

    def step(self, action: str) -> Any:
        """End after the second turn."""
        self.turns += 1
        over = self.turns == 2
        return "Once more.", float(over and self.wins), over, False, {"correct": self.wins} if over else {}

    def sample_random_action(self) -> str:
        """Return one of two words."""
        return f"\\boxed{{{self.action_random.choice(['fact', 'lie'])}}}"


class Telling(gem.DatasetEnv):
    """Shows in the info of the reset what a function makes of the row.

    Args:
        tell: Called with the row, returns more for the info.
        **options: See ``DatasetEnv``.
    """

    def __init__(self, tell: Any, **options: Any) -> None:
        super().__init__(**options)
        self.tell = tell

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Ask, and tell."""
        observation, info = super().reset(seed=seed, options=options)
        return observation, {**info, **self.tell(self._row)}


class ShellHere(gem.Env):
    """Runs commands on this machine."""

    commands: ClassVar[list[str]] = []
    """All that were run."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Ask."""
        super().reset(seed=seed)
        return "Solve it in the shell: <bash>command</bash>, then <finish/>.", {}

    def step(self, action: str) -> Any:
        """Run."""
        command = gem.extract_last_tagged_answer(action, "bash")
        if command is not None:
            self.commands.append(command)
            subprocess.run(command, shell=True, check=False, capture_output=True, timeout=20)
        over = "<finish/>" in action
        return "$", 0.0, over, False, {"correct": False} if over else {}

    def sample_random_action(self) -> str:
        """Return a command."""
        return "<bash>true</bash>"


class OwnClass(gem.Env):
    """Not a data set, without gold_action: one capital a seed.

    Args:
        tell: Called with the answer; returns more text for the observation, or more for the info.
        solves: Called with a response that may be wrong; what it grades so is right as well. It may raise.
        sample: Returns a random action.
    """

    def __init__(self, tell: Any = None, solves: Any = None, sample: Any = None) -> None:
        super().__init__()
        self.tell, self.solves, self.sample = tell, solves, sample

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Ask, and tell."""
        super().reset(seed=seed)
        self.country = str(self.np_random.choice(list(CAPITALS)))
        asked = f"Name the capital of {self.country} inside \\boxed{{}}."
        told = self.tell(CAPITALS[self.country]) if self.tell else {}
        return (f"{asked}\n{told}", {}) if isinstance(told, str) else (asked, told)

    def step(self, action: str) -> Any:
        """Grade."""
        right = gem.extract_last_boxed_answer(action) == CAPITALS[self.country]
        correct = bool(self.solves(action)) if self.solves else right
        return gem.TERMINAL_STATE, float(correct), True, False, {"correct": correct}

    def sample_random_action(self) -> str:
        """Return what the function returns, if there is one."""
        return self.sample(self.action_random) if self.sample else super().sample_random_action()


class TwoTries(OwnClass):
    """Two tries; a wrong answer is told the right one before the second.

    Args:
        told: What is said of the right answer.
    """

    def __init__(self, told: str) -> None:
        super().__init__(sample=lambda draws: f"\\boxed{{{draws.choice(list(CAPITALS.values()))}}}")
        self.told = told

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Ask."""
        self.tries = 0
        return super().reset(seed)

    def step(self, action: str) -> Any:
        """Grade; tell."""
        self.tries += 1
        correct = gem.extract_last_boxed_answer(action) == CAPITALS[self.country]
        over = correct or self.tries == 2
        told = gem.TERMINAL_STATE if over else self.told.format(CAPITALS[self.country])
        return told, float(correct), over, False, {"correct": correct} if over else {}

    def gold_action(self) -> str:
        """Return the right answer."""
        return f"\\boxed{{{CAPITALS[self.country]}}}"


class TellingTool(gem.DatasetEnv):
    """Offers a tool that returns the answer."""

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        """Ask, with a tool."""
        observation, info = super().reset(seed=seed, options=options)
        schema = {"type": "object", "properties": {"text": {"type": "string"}}, "required": ["text"]}
        function = {"name": "lookup", "description": "Looks up.", "parameters": schema}
        return observation, {**info, "tools": [{"type": "function", "function": function}]}

    def step(self, action: str) -> Any:
        """Grade, or look up."""
        if '"lookup"' in action and '"text"' in action:
            return f"On {self._row['question'][:10]} see {self._row['answer']}", 0.0, False, False, {}
        return super().step(action)


class Stateful(gem.DatasetEnv):
    """Every third episode of an instance is right, whatever is said."""

    count = 0

    def grade(self, action: str, row: Any) -> Grade:
        """Grade by number."""
        self.count += 1
        return verdict(self.count % 3 == 0 or boxed(action) == row["answer"])


def others(country: str, number: int) -> list[str]:
    """Return two wrong capitals."""
    wrong = [capital for name, capital in CAPITALS.items() if name != country]
    return random.Random(number).sample(wrong, 2)


CHOICES = [
    {
        "question": f"What is the capital of {country}?\nA) {a}\nB) {b}\nC) {c}\nAnswer with a letter in \\boxed{{}}.",
        "answer": "ABC"[[a, b, c].index(CAPITALS[country])],
    }
    for number, country in enumerate(CAPITALS)
    for a, b, c in [random.Random(number).sample([CAPITALS[country], *others(country, number)], 3)]
]
PASSAGES = [
    {
        "question": f"{country} lies far away, and its people like {country}. Its capital {capital} is large. Which "
        "one is it? Answer in \\boxed{}.",
        "answer": capital,
    }
    for country, capital in CAPITALS.items()
]
DECODE = [
    {"question": f"Decode this: {codecs.encode(capital, 'rot13')}", "answer": capital} for capital in CAPITALS.values()
]
YES_NO = [
    {"question": f"Is {n} divisible by 3? Answer yes or no in \\boxed{{}}.", "answer": "no" if n % 3 else "yes"}
    for n in range(10, 60)
]
ENDINGS = {
    "plain": str,
    "upper": str.upper,
    "hex": lambda text: text.encode().hex(),
    "base64": lambda text: base64.b64encode(text.encode()).decode(),
    "rot13": lambda text: codecs.encode(text, "rot13"),
}


MOOD = random.Random(3)


def in_a_shell(action: str, row: Any) -> Grade:
    """The answer is put into a command."""
    done = subprocess.run(f"test '{boxed(action)}' = '{row['answer']}'", shell=True, check=False, capture_output=True)
    return verdict(done.returncode == 0)


def ended(form: Any) -> list[dict[str, str]]:
    """Return rows whose question ends with the answer in a form."""
    return [{**row, "question": f"{row['question']}\n{form(row['answer'])}"} for row in ROWS]


GRADERS = {
    "word": ("injection", grader(lambda action, gold: "correct" in action.lower())),
    "judge": ("injection", judged_by_prompt),
    "length": ("injection", grader(lambda action, gold: len(action) > 2000)),
    "empty": ("null", accepts_nothing),
    "mention": ("hedge", grader(lambda action, gold: gold.lower() in action.lower())),
    "boxes": ("hedge", grader(lambda action, gold: gold in re.findall(r"\\boxed\{(\w+)\}", action))),
    "any-box": ("other", grader(lambda action, gold: gem.extract_last_boxed_answer(action))),
    "pattern": ("tamper", matches_a_pattern),
    "shell": ("tamper", in_a_shell),
    "letter": ("tamper", grader(lambda action, gold: (said := boxed(action).strip().lower()) and said in gold.lower())),
    "mood": ("nondeterministic", lambda action, row: verdict(boxed(action) == row["answer"] and MOOD.random() < 0.8)),
}
"""Careless graders of the capitals, and what they fall for."""

TOLD = {
    "info": (ROWS, lambda row: {"meta": {"debug": f"gold={row['answer']}"}}),
    "info-backward": (ROWS, lambda row: {"check": row["answer"][::-1]}),
    "info-base64": (ROWS, lambda row: {"check": ENDINGS["base64"](row["answer"])}),
    "info-option": (PASSAGES, lambda row: {"chosen": row["answer"]}),
    "info-index": (CHOICES, lambda row: {"k": "ABC".index(row["answer"])}),
    "info-id": (ROWS, lambda row: {"task_id": f"q-{row['answer']}"}),
}
"""Rows, and the info that gives their answers away."""

OWN = {
    "info": lambda capital: {"extra": {"x7": capital}},
    "text": lambda capital: f"<!-- expected: {capital} -->",
    **{f"ends-{name}": form for name, form in ENDINGS.items()},
}
"""What an environment without gold answers shows."""


LUCKY = {
    "solves": lambda action: action.startswith("I say "),
    "sample": lambda draws: f"I say {draws.integers(1000)}",
}
"""Whatever is sampled is right."""


def planted() -> dict[str, tuple[Any, dict[str, Any], str]]:
    """Return what to register by name: entry point, keyword arguments, and the kind of problem to be found."""
    data = gem.DatasetEnv
    template = {"prompt_template": "{question} (hidden: {gold_copy})"}
    shown = [{**row, "gold_copy": row["answer"]} for row in ROWS]
    return {
        **{name: (data, {"rows": ROWS, "grade": grade}, kind) for name, (kind, grade) in GRADERS.items()},
        **{name: (Telling, {"rows": rows, "tell": tell}, "leak") for name, (rows, tell) in TOLD.items()},
        **{f"own-{name}": (OwnClass, {"tell": tell}, "leak") for name, tell in OWN.items()},
        **{f"ends-{name}": (data, {"rows": ended(form)}, "leak") for name, form in ENDINGS.items()},
        "eval": (data, {"rows": SUMS, "grade": evaluates}, "tamper"),
        "eval-scope": (data, {"rows": SUMS, "grade": evaluates_in_its_scope}, "tamper"),
        "nan": (data, {"rows": SUMS, "grade": compares_by_distance}, "tamper"),
        "exec": (CodeRows, {"rows": CODE_ROWS, "grade": run_in_the_grader}, "tamper"),
        "exit-code": (CodeRows, {"rows": CODE_ROWS, "grade": run_and_exit}, "tamper"),
        "shown": (data, {"rows": shown, **template}, "leak"),
        "shell-here": (ShellHere, {}, "tamper"),
        "own-constant": (OwnClass, {"solves": lambda action: "{yes}" in action}, "constant"),
        "own-lucky": (OwnClass, LUCKY, "random"),
        "corrects": (TwoTries, {"told": "No, people live in {} there."}, "leak"),
        "tool": (TellingTool, {"rows": ROWS}, "leak"),
        "crash": (OwnClass, {"solves": lambda action: action.split("\\boxed{")[1] == "?"}, "crash"),
        "two-tries": (TwoTries, {"told": "Wrong, the right answer was {}. Once more!"}, "leak"),
        "stateful": (Stateful, {"rows": ROWS}, "nondeterministic"),
        "wrong-gold": (data, {"rows": [*ROWS[1:], {**ROWS[0], "answer": "a } b </answer> c"}]}, "gold"),
        "no-gold": (data, {"rows": [*ROWS, {"question": "And of Laos?", "answer": ""}]}, "no gold"),
        "duplicates": (data, {"rows": [*ROWS, {**ROWS[2], "question": ROWS[2]["question"].upper()}]}, "duplicates"),
        "conflict": (data, {"rows": [*ROWS, {**ROWS[2], "answer": "Barcelona"}]}, "conflict"),
    }


def sound() -> dict[str, tuple[Any, dict[str, Any]]]:
    """Return what to register by name: entry point and keyword arguments."""
    data = gem.DatasetEnv
    return {
        "capitals": (data, {"rows": ROWS}),
        "sums": (data, {"rows": SUMS}),
        "choices": (data, {"rows": CHOICES}),
        "passages": (data, {"rows": PASSAGES}),
        "yes-no": (data, {"rows": YES_NO}),
        "own-class": (OwnClass, {}),
        "options": (Telling, {"rows": CHOICES, "tell": lambda row: {"options": row["question"].splitlines()[1:4]}}),
        "level": (Telling, {"rows": YES_NO, "tell": lambda row: {"level": len(row["question"]) % 3}}),
        "duel": (Duel, {}),
        "decode": (data, {"rows": DECODE}),
        "one-row": (data, {"rows": ROWS[:1]}),
        "plain-text": (data, {"rows": ROWS, "grade": lambda action, row: verdict(action.strip() == row["answer"])}),
    }
