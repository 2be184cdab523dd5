r"""Wordle: find a secret word; each guess is marked letter by letter."""

from __future__ import annotations

from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_flag, check_whole, painted, sizes_to_draw
from gem_games.words import letters, word_list

_SIZES = (3, 15), (4, 20), (5, 25)
_SHORTEST, _LONGEST = 3, 12
_ALPHABET = "ABCDEFGHIJKLMNOPQRSTUVWXYZ"
_COLOURS = {"G": "green", "Y": "yellow", "X": "dim"}


class WordleEnv(Game):
    r"""Find a word by guesses such as ``\boxed{crane}``.

    Each letter of a guess is marked: G (green) in its right place, Y (yellow) elsewhere in the word, X not in the word.
    A letter gets as many marks G and Y as the word has of it, G first.

    - A guess: ``0.5 / length`` for each place that is green for the first time. The right word: 0.5 on top of that, and
      the game is won. The rewards of a won game add up to 1.
    - A guess of the wrong length, made before, or that is no word: reward 0, and no marks.
    - The last turn is rewarded like any other.
    - Not letters from a to z (capitals or not, with spaces between them or not): reward -0.1, the game is over.

    The secret is a common word, a guess may be a rare one. gem-llm accepts any letters as a guess, whatever its
    parameter ``only_real_words`` says; here the parameter does what it says.

    Args:
        word_length: Letters of the word.
        only_real_words: Whether a guess must be an English word, as ``gem_games.words`` knows them.
        max_turns: Guesses allowed.
        format_error_ends: See ``Game``.

    Where ``word_length`` or ``max_turns`` is None, a size is drawn from (3, 15), (4, 20) and (5, 25), and what was
    given replaces its part of it.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "is not a word of the letters from A to Z."

    def __init__(
        self,
        word_length: int | None = 5,
        only_real_words: bool = True,
        max_turns: int | None = 20,
        *,
        format_error_ends: bool = True,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("word_length", word_length, _SHORTEST, _LONGEST)
        check_whole("max_turns", max_turns, 1, 10**15)
        check_flag("only_real_words", only_real_words)
        self.only_real_words = only_real_words
        self._sizes: list[tuple[int, int]] = sizes_to_draw(_SIZES, (word_length, max_turns))
        self.word_length, self.max_turns = self._sizes[0]
        self.word = ""
        self._begin()

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self.word_length, self.max_turns = self._sizes[draws.below(len(self._sizes))]
        common = word_list(self.word_length).common
        self.word = common[draws.below(len(common))].upper()
        self._begin()

    def _begin(self) -> None:
        self.guesses: dict[str, str] = {}
        """The guesses and their marks."""
        self._green = [False] * self.word_length
        self._marked = ""

    def _rules(self) -> str:
        accepted = ", or that is not an English word," if self.only_real_words else ""
        return (
            "Wordle: find a secret English word.\n"
            "Each guess gets a mark for each of its letters, in their order: G for a letter in its right place, Y for "
            "one that is elsewhere in the word, X for one that is not in it. A letter that the word has once gets G or "
            "Y only once. A guess of another length, one that you have made before"
            f"{accepted} costs a turn and gets no marks.\n"
            f"Write your guess inside \\boxed{{}}, for example \\boxed{{{word_list(self.word_length).common[0]}}}.\n"
        )

    def _situation(self) -> str:
        return (
            f"\nThe word has {self.word_length} letters. Guesses so far:{self._marked or ' none'}\n"
            + self._turns_left("Put your guess inside \\boxed{}.")
        )

    def _read(self, answer: str) -> str | None:
        return letters(answer)

    def _play(self, guess: str) -> StepResult:
        if len(guess) != self.word_length:
            return self._invalid(f"Your guess has length {len(guess)}, and the word has length {self.word_length}.")
        if guess in self.guesses:
            return self._invalid(f"You have guessed {guess} before.")
        if self.only_real_words and guess.lower() not in word_list(self.word_length).known:
            return self._invalid(f"{guess} is not in the list of words.")
        reward = self._mark(guess)
        if guess == self.word:
            return self._win(guess, f"{guess} is right: you found the word.", reward + 0.5)
        return self._move(guess, f"{guess} is marked {self.guesses[guess]}.", reward, reward)

    def _mark(self, guess: str) -> float:
        """Note the marks of a guess, and return the reward for places that are green for the first time."""
        marks = marks_of(guess, self.word)
        fresh = 0
        if "G" in marks:
            for place, mark in enumerate(marks):
                if mark == "G" and not self._green[place]:
                    self._green[place] = True
                    fresh += 1
        self.guesses[guess] = spaced = " ".join(marks)
        self._marked = f"{self._marked}\n{guess}: {spaced}"
        return 0.5 * fresh / self.word_length

    def _solution(self) -> str:
        return f" The word was {self.word}."

    def _gold_answer(self) -> str | None:
        return self.word

    def _random_answer(self) -> str:
        """Draw an English word that was not guessed before, common or not."""
        words = word_list(self.word_length).every
        while True:
            word = words[int(self.action_random.random() * len(words))]
            # One is left while the game goes on, the right one; after the end there may be none.
            if word.upper() not in self.guesses or self.outcome != "playing":
                return word

    def _drawing(self) -> str:
        rows = []
        best: dict[str, str] = {}
        for guess, marks in self.guesses.items():
            pairs = list(zip(guess, marks.split(), strict=True))
            rows.append("  " + " ".join(painted(letter, _COLOURS[mark]) for letter, mark in pairs))
            for letter, mark in pairs:
                best[letter] = min(best.get(letter, "Z"), mark, key="GYXZ".index)
        if self.outcome == "playing":
            rows.append("  " + " ".join("_" * self.word_length))
        elif self.outcome == "lost":
            rows.append("  " + painted(" ".join(self.word), "bold"))
        keys = (painted(letter, _COLOURS[best[letter]]) if letter in best else letter for letter in _ALPHABET)
        return "\n".join([*rows, "", "".join(keys)])


def marks_of(guess: str, word: str) -> list[str]:
    """Return a mark for each letter of a guess: ``"G"``, ``"Y"`` or ``"X"``."""
    left, marks = word, []
    for letter, right in zip(guess, word, strict=True):
        if letter == right:
            left = left.replace(letter, "", 1)
            marks.append("G")
        else:
            marks.append("X")
    for place, letter in enumerate(guess):
        if letter in left and marks[place] == "X":
            left = left.replace(letter, "", 1)
            marks[place] = "Y"
    return marks
