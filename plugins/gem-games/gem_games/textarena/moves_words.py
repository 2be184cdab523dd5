"""Moves of word games. Each function returns moves that are all valid now."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from string import ascii_lowercase, ascii_uppercase
from typing import TYPE_CHECKING, Any

from gem_games import words
from gem_games.textarena.moves_talk import Sampler, remark

if TYPE_CHECKING:
    import random

_TRIES = 50


def _drawn(draw: Callable[[], str], taken: Callable[[str], bool]) -> Sequence[str]:
    """Return one text that is not taken, if some draws find one."""
    for _ in range(_TRIES):
        text = draw()
        if not taken(text):
            return [text]
    return ()


def _bracketed(texts: Iterable[str]) -> list[str]:
    return [f"[{text}]" for text in texts]


def _spelled_with(letters: str, lengths: Iterable[int]) -> Iterable[tuple[str, ...]]:
    """Return, for each length, the words that have no other letters than these."""
    # What strip leaves of a word begins with another letter.
    return (tuple(word for word in words.word_list(length).every if not word.strip(letters)) for length in lengths)


def _hangman(game: Any, rng: random.Random) -> Sequence[str]:
    return _bracketed(letter for letter in ascii_uppercase if letter not in game.state.game_state["guessed_letters"])


def _wordle(game: Any, rng: random.Random) -> Sequence[str]:
    guessed = {word for word, _ in game.state.game_state["guess_history"]}
    known = words.word_list(game.state.game_state["word_length"]).common
    return _bracketed(_drawn(lambda: rng.choice(known), guessed.__contains__))


def _word_ladder(game: Any, rng: random.Random) -> Sequence[str]:
    word, known = game.current_word, words.word_list(len(game.current_word)).known
    changed = (
        word[:place] + letter + word[place + 1 :]
        for place, old in enumerate(word)
        for letter in ascii_lowercase
        if letter != old
    )
    return _bracketed(found for found in changed if found in known)


def _word_chains(game: Any, rng: random.Random) -> Sequence[str]:
    state = game.state.game_state
    start, used = state["required_start_letter"], state["used_words"]
    every = words.word_list(state["required_length"]).every
    return _bracketed(word for word in every if word.startswith(start) and word not in used)


def _spelling_bee(game: Any, rng: random.Random) -> Sequence[str]:
    """Return words of the shortest length that has any, since the next word must not be shorter."""
    state = game.state.game_state
    used = state["word_history"]
    lengths = range(len(used[-1]) if used else words.LENGTHS[0], words.LENGTHS[-1] + 1)
    fitting = _spelled_with("".join(state["allowed_letters"]), lengths)
    return next((found for each in fitting if (found := _bracketed(word for word in each if word not in used))), ())


def _word_search(game: Any, rng: random.Random) -> Sequence[str]:
    """Return a row or a column, or a part of one, that has not been tried."""
    size, tried = len(game.state.game_state["board"]), {tuple(each) for each in game.incorrect_attempts}

    def line() -> tuple[int, int, int, int]:
        fixed, one, other = (rng.randrange(size) for _ in range(3))
        return (fixed, one, fixed, other) if rng.random() < 0.5 else (one, fixed, other, fixed)

    lines = (line() for _ in range(_TRIES))
    return [f"[{' '.join(map(str, each))}]" for each in lines if each not in tried][:1]


def _letter_auction(game: Any, rng: random.Random) -> Sequence[str]:
    seat = game.state.current_player_id
    own, other = game.player_states[seat], game.player_states[1 - seat]
    if game.round_number >= len(game.letters):
        spelled = _spelled_with("".join(own["letters"]).lower(), words.LENGTHS)
        return next((_bracketed(each) for each in spelled if each), ())
    raised = other["letter_bid_history"][game.round_number] == "bid"
    least = game.bid_amount + raised
    bids = [f"[bid {rng.randint(least, min(own['coins'], least + 5))}]"] if least <= own["coins"] else []
    return ["[pass]", *bids]


def _codenames(game: Any, rng: random.Random) -> Sequence[str]:
    state = game.state.game_state
    if game.state.current_player_id in (1, 3):
        return _bracketed(["pass", *(word for word in game.board if word not in state["guessed_words"])])
    clues = _drawn(
        lambda: rng.choice(words.nouns(rng.randrange(4, 9))),
        lambda clue: any(clue in word or word in clue for word in game.board),
    )
    return [f"[{clue} {rng.randint(1, 3)}]" for clue in clues]


def _taboo(game: Any, rng: random.Random) -> Sequence[str]:
    state = game.state.game_state
    if game.state.role_mapping[game.state.current_player_id] == "Guesser":
        return _bracketed([rng.choice(list(game.data))])
    forbidden = " ".join([state["word_to_guess"], *state["taboo_words"]]).lower().split()
    return _drawn(lambda: rng.choice(words.nouns(rng.randrange(4, 9))), forbidden.__contains__)


SAMPLERS: dict[str, Sampler] = {
    "Codenames": _codenames,
    "DontSayIt": remark,
    "Hangman": _hangman,
    "LetterAuction": _letter_auction,
    "SpellingBee": _spelling_bee,
    "Taboo": _taboo,
    "WordChains": _word_chains,
    "WordLadder": _word_ladder,
    "WordSearch": _word_search,
    "Wordle": _wordle,
}
