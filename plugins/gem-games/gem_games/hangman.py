r"""Hangman: find a word by asking for letters, and say it."""

from __future__ import annotations

from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_flag, check_whole, painted, sizes_to_draw
from gem_games.words import word_list

_SIZES = (3, 10), (5, 15), (7, 20)
_SHORTEST, _LONGEST = 3, 15
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"


class HangmanEnv(Game):
    r"""Ask for a letter with ``\boxed{e}``, or say the whole word with ``\boxed{crane}``.

    - A letter that is in the word is shown in all its places: ``0.5 * places / length``.
    - The right word: ``0.5 + 0.5 * places still hidden / length``, and the game is won. The word must be said,
      also when all its letters are shown. The rewards of a won game add up to 1.
    - A letter that is not in the word, or another word: reward 0.
    - A letter or word that was tried before, or a word of another length: reward 0, nothing changes.
    - The last turn is rewarded like any other.
    - Not letters from a to z, capitals or not: reward -0.1, the game is over.

    Args:
        word_length: Letters of the word.
        hardcore: Whether the word may be a rare one.
        max_turns: Letters and words that may be tried.
        format_error_ends: See ``Game``.

    Where ``word_length`` or ``max_turns`` is None, a size is drawn from (3, 10), (5, 15) and (7, 20), and what was
    given replaces its part of it.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is neither a letter nor a word of the letters from A to Z."

    def __init__(
        self,
        word_length: int | None = 5,
        hardcore: bool = False,
        max_turns: int | None = 20,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("word_length", word_length, _SHORTEST, _LONGEST)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_flag("hardcore", hardcore)
        self.hardcore = hardcore
        self._sizes: list[tuple[int, int]] = sizes_to_draw(_SIZES, (word_length, max_turns))
        self.word_length, self.max_turns = self._sizes[0]
        self.word = ""
        self._begin()

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self.word_length, self.max_turns = self._sizes[draws.below(len(self._sizes))]
        pool = self._pool()
        self.word = pool[draws.below(len(pool))].upper()
        self._begin()

    def _begin(self) -> None:
        self.tried: list[str] = []
        """Letters and words, in the order in which they were tried."""
        self.shown = ["_"] * self.word_length

    def _pool(self) -> tuple[str, ...]:
        listed = word_list(self.word_length)
        return listed.every if self.hardcore else listed.common

    def _rules(self) -> str:
        example = self._pool()[0]
        return (
            "Hangman: find a secret English word.\n"
            "In each turn you ask for a letter, which is then shown wherever the word has it, or say the whole word. "
            "You win by saying the word, also when all its letters are shown. What you have tried before, and a word "
            "of another length, costs a turn.\n"
            f"Write a letter or a word inside \\boxed{{}}, for example \\boxed{{{example[0]}}} or "
            f"\\boxed{{{example}}}.\n"
        )

    def _situation(self) -> str:
        return (
            f"\nThe word has {self.word_length} letters: {' '.join(self.shown)}\n"
            f"Tried so far: {', '.join(self.tried) or 'nothing'}.\n"
            + self._turns_left("Put a letter or the whole word inside \\boxed{}.")
        )

    def _read(self, answer: str) -> str | None:
        return answer.upper() if answer.isascii() and answer.isalpha() else None

    def _play(self, guess: str) -> StepResult:
        if len(guess) == 1:
            return self._play_letter(guess)
        if len(guess) != self.word_length:
            return self._invalid(f"Your guess has length {len(guess)}, and the word has length {self.word_length}.")
        if guess == self.word:
            reward = 0.5 + 0.5 * self.shown.count("_") / self.word_length
            return self._win(guess, f"{guess} is right: you found the word.", reward)
        if guess in self.tried:
            return self._invalid(f"You have tried {guess} before.")
        self.tried.append(guess)
        return self._move(guess, f"The word is not {guess}.", 0.0, 0.0)

    def _play_letter(self, letter: str) -> StepResult:
        if letter in self.tried:
            return self._invalid(f"You have tried {letter} before.")
        self.tried.append(letter)
        places = self.word.count(letter)
        if not places:
            return self._move(letter, f"The word has no {letter}.", 0.0, 0.0)
        self._show(letter)
        reward = 0.5 * places / self.word_length
        feedback = f"The word has {letter} in {places} {'place' if places == 1 else 'places'}."
        if "_" not in self.shown:
            feedback += " Say the word to win."
        return self._move(letter, feedback, reward, reward)

    def _show(self, letter: str) -> None:
        self.shown = [right if right == letter else old for right, old in zip(self.word, self.shown, strict=True)]

    def _solution(self) -> str:
        return f" The word was {self.word}."

    def _gold_answer(self) -> str | None:
        return self.word

    def _random_answer(self) -> str:
        """Draw a letter that was not tried, and now and then a word."""
        choice = self.action_random.random()
        untried = [letter for letter in _ALPHABET if letter not in self.tried]
        if untried and choice < 0.8:
            return untried[int(choice / 0.8 * len(untried))].lower()
        pool = self._pool()
        index = int(self.action_random.random() * len(pool))
        # The walk ends, since the secret word was not tried while the game goes on.
        while pool[index % len(pool)].upper() in self.tried and self.outcome == "playing":
            index += 1
        return pool[index % len(pool)]

    def _drawing(self) -> str:
        lost = self.outcome == "lost"
        shown = (
            painted(right, "red") if lost and old == "_" else painted(old, "dim" if old == "_" else "bold")
            for right, old in zip(self.word, self.word if self.outcome == "won" else self.shown, strict=True)
        )
        keys = (self._key(letter) for letter in _ALPHABET)
        said = ", ".join(guess for guess in self.tried if len(guess) > 1)
        return f"  {' '.join(shown)}\n\n{''.join(keys)}" + (f"\nnot: {said}" if said else "")

    def _key(self, letter: str) -> str:
        if letter not in self.tried:
            return letter
        return painted(letter, "green") if letter in self.word else painted("·", "dim")
