"""Agents that win the games of one player from what they are shown, by the first word of an id; and how to play."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

from gem_games.agents import BisectionAgent, HanoiAgent, MastermindAgent
from gem_games.crosswords import clues
from gem_games.wiki.agent import WikiGameAgent
from gem_games.wordle import marks_of
from gem_games.words import words


def played(env: Any, seed: int, agent: Any = None) -> list[Any]:
    """Play an episode, at random without an agent, and return all that it gave."""
    records: list[Any] = [env.reset(seed=seed)]
    while len(records) == 1 or not records[-1][2]:
        records.append(env.step(agent(records[-1][0]) if agent else env.sample_random_action()))
    return records


def box(answer: object) -> str:
    """Return an answer in words."""
    return f"I say \\boxed{{{answer}}}."


class WordleSolver:
    """Guesses the first common word that agrees with all marks that the observation shows."""

    def __call__(self, observation: str) -> str:
        length = int(re.findall(r"The word has (\d+) letters", observation)[-1])
        marked = re.findall(r"^([A-Z]+):((?: [GYX])+)$", observation, re.MULTILINE)
        if not marked:
            self.left = [word.upper() for word in words(length)]
        else:
            guess, marks = marked[-1][0], marked[-1][1].split()
            self.left = [word for word in self.left if word != guess and marks_of(guess, word) == marks]
        return box(self.left[0])


def crossword_solver(observation: str) -> str:
    """Look the clues up in the lists they come from, and fill in the first letter that is missing."""
    known = {clue: word for hard in (False, True) for word, clue in clues(hard).of.items()}
    rows = [row.split()[1:] for row in re.findall(r"^ ?\d+(?:  \S)+$", observation, re.MULTILINE)]
    listed = re.findall(r"^(across|down) from row (\d+) column (\d+), (\d+) letters: (.+)$", observation, re.MULTILINE)
    for direction, row, column, length, clue in listed:
        assert len(known[clue]) == int(length)
        for place, letter in enumerate(known[clue]):
            at = int(row) + place * (direction == "down"), int(column) + place * (direction == "across")
            if rows[at[0]][at[1]] == "_":
                return box(f"{at[0]} {at[1]} {letter.lower()}")
    raise AssertionError("no cell is empty")


def word_search_solver(observation: str) -> str:
    """Scan rows and columns for the first word that is still to be found."""
    word = re.findall(r"Words to find: ([A-Z]+)", observation)[-1]
    rows = [row.split()[1:] for row in re.findall(r"^ ?\d+(?:  [A-Za-z])+$", observation, re.MULTILINE)]
    grid = ["".join(row).upper() for row in rows]
    for lines, down in ((grid, False), (["".join(column) for column in zip(*grid, strict=True)], True)):
        for number, line in enumerate(lines):
            if word in line:
                begin, end = line.index(word), line.index(word) + len(word) - 1
                return box(f"{begin} {number} {end} {number}" if down else f"{number} {begin} {number} {end}")
    raise AssertionError(f"{word} is not in the grid")


SOLVERS: dict[str, Callable[[], Any]] = {
    "GuessTheNumber": BisectionAgent,
    "Mastermind": MastermindAgent,
    "TowerofHanoi": HanoiAgent,
    "Wordle": WordleSolver,
    "Crosswords": lambda: crossword_solver,
    "WordSearch": lambda: word_search_solver,
    "WikiGame": WikiGameAgent,
}
