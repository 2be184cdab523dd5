r"""WikiGame: go from one article to another by following links."""

from __future__ import annotations

import re
import textwrap
from collections.abc import Iterable, Iterator
from itertools import chain, islice
from pathlib import Path
from typing import Any

from gem_core.errors import ArgumentError
from gem_core.types import ResetResult, StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, quote
from gem_games.wiki.articles import Article, load_articles

VARIANTS = "noregrets", "oneback", "freenav", "eidetic"
BACK = "<PREV_PAGE>"
_PART = re.compile(r"<LINKS\s{1,9}(\d{1,6})>", re.ASCII)
_UNITS = "characters", "words", "sentences"
_SENTENCE_END = re.compile(r"(?<=[.!?])\s+")
_STEP, _WRONG = -0.05, -0.2
_TURN_LIMITS = 15, 30
_MOST_TURNS, _FARTHEST = 10**6, 100
_LONGEST_HINT = 200


class WikiGameEnv(Game):
    r"""Reach a target article by following links such as ``\boxed{Ancient Rome}``.

    - Following the link to the target: reward 1, the game is won.
    - Following another link: reward -0.05.
    - A title that cannot be taken now, or a step back where none is allowed: reward -0.2, nothing moves.
    - No box, or an empty one: reward -0.2; it costs a turn and does not end the game, unlike in the other games.
    - An article without links ends the game with reward 0. In ``"oneback"`` and ``"freenav"`` it sends you back
      instead, at the price of two turns: reward -0.1.
    - In the last turn, another link, another part of the links, or a title that cannot be taken: reward 0.
    - ``\boxed{<LINKS 2>}`` shows the second part of a list of links that is too long to be shown at once. As any move
      it costs a turn: reward -0.05. A link can be taken whether it is shown or not.

    Unlike in gem-llm the last turn ends the game as ``terminated``, the start and the target come from the seed, and a
    way between them exists. An article is shown by its first 500 characters, there by 100, and the target by its title
    alone.

    Args:
        max_turns: Turns allowed. None draws 15 or 30.
        variant: ``"noregrets"``: only links of the present article. ``"oneback"``: also ``\boxed{<PREV_PAGE>}``, never
            twice in a row. ``"freenav"``: that too, as often as you like. ``"eidetic"``: any link seen in this game.
        min_distance: Fewest links between start and target.
        max_distance: Most links on the shortest way between them, but never more than ``max_turns``.
        articles: A file of JSON lines, ``{"title": …, "text": "… [[Title]] … [[Title|words]] …"}``. None: some 500
            that are shipped here.
        page_summary_length: How much of an article is shown, such as ``(100, "characters")``; the unit may also be
            ``"words"`` or ``"sentences"``.
        links_per_part: Links that are shown at once.
        format_error_ends: See ``Game``.

    ``reset(options={"start": …, "target": …})`` plays between two articles of your choice.

    Source: variants and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    shared_by_forks = ("articles",)
    format_error_reward = _WRONG
    unreadable = "is no title."

    def __init__(
        self,
        max_turns: int | None = 30,
        variant: str = "noregrets",
        min_distance: int = 2,
        max_distance: int = 6,
        articles: str | Path | None = None,
        page_summary_length: tuple[int, str] | list[Any] = (500, "characters"),
        links_per_part: int = 100,
        *,
        format_error_ends: bool = False,
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("max_turns", max_turns, 1, _MOST_TURNS)
        if variant not in VARIANTS:
            raise ArgumentError(f"variant must be one of {', '.join(map(repr, VARIANTS))}, not {variant!r}")
        _check_distances(min_distance, max_distance, max_turns)
        if type(links_per_part) is not int or links_per_part < 1:
            raise ArgumentError(f"links_per_part must be a whole number from 1 up, not {links_per_part!r}")
        self.articles = load_articles(None if articles is None else str(articles))
        self.variant = variant
        self.links_per_part = links_per_part
        self._summary_length, self._summary_unit = _checked_summary(page_summary_length)
        self._given_turns = max_turns
        self._distances = min_distance, max_distance
        self._wanted: tuple[str, str] | None = None
        self.max_turns = max_turns or 0
        self.path: list[Article] = []
        self.start = self.target = ""
        self.distance: int | None = None
        self._begin()

    def reset(self, seed: int | None = None, options: dict[str, Any] | None = None) -> ResetResult:
        """Begin a game.

        Args:
            seed: See ``Env.reset``.
            options: ``{"start": title, "target": title}``, or none to draw them.

        Raises:
            ArgumentError: There are no such articles, or no way between them.
        """
        self._wanted = _checked_pair(options) if options else None
        return super().reset(seed)

    def _deal(self, draws: CheapRandom) -> None:
        self.max_turns = self._given_turns or _TURN_LIMITS[draws.below(2)]
        if self._wanted:
            self.start, self.target = self._wanted
            self.distance = len(self.articles.way(self.start, self.target)) - 1
            if not self.distance:
                raise ArgumentError(f"start and target are the same article, {self.start!r}; choose two")
        else:
            nearest, farthest = self._distances
            self.start, self.target, self.distance = self.articles.pair(draws, nearest, min(farthest, self.max_turns))
        self.path = [self.articles.article(self.start)]
        self._begin()

    def _begin(self) -> None:
        self.went_back = False
        self.part = 1

    # What can be said.

    def _rules(self) -> str:
        return (
            "WikiGame: go from one article to another by following links.\n"
            f"Each article shows its links. Follow one by its exact title inside \\boxed{{}}. A title that is not "
            f"among the links costs a turn.\n{self._variant_rule()}"
            f"Start at {self.start} and reach {self.target}; the fewer turns you need, the better.\n"
        )

    def _variant_rule(self) -> str:
        if self.variant == "noregrets":
            return "There is no way back but by links, and an article without links ends the game.\n"
        if self.variant == "eidetic":
            return "You may also follow any link that you have seen earlier in this game.\n"
        limit = ", but not twice in a row" if self.variant == "oneback" else ""
        return (
            f"\\boxed{{{BACK}}} takes you back to the article before{limit}; it costs a turn as well. An article "
            "without links sends you back by itself, which costs a second turn.\n"
        )

    def _situation(self) -> str:
        here = self.path[-1]
        what = "Links that you may follow" if self.variant == "eidetic" else "Links from here"
        return (
            f"\nYour target: {self.target}.\nYou are at: {here.title}.\n"
            f"{_summary(here, self._summary_length, self._summary_unit)}\n"
            + _listed(self._open_titles(), what, self.part, self.links_per_part)
            + self._turns_left("Put the title of a link inside \\boxed{}.")
        )

    def _open_titles(self) -> tuple[str, ...]:
        """Return the titles that can be taken now, those of the present article first."""
        if self.variant != "eidetic":
            return self.path[-1].links
        return tuple(dict.fromkeys(chain.from_iterable(article.links for article in reversed(self.path))))

    # What is played.

    def _play(self, answer: str) -> StepResult:
        if answer == BACK:
            return self._go_back()
        part = _PART.fullmatch(answer)
        if part is not None:
            return self._turn_to(int(part[1]))
        titles = self._open_titles()
        if answer not in titles:
            answer_as_title = answer.replace("_", " ") if len(answer) <= _LONGEST_HINT else answer
            if answer_as_title not in titles:
                return self._wrong(f"{quote(answer)} is not among the links.{_hint(answer, titles)}")
            answer = answer_as_title
        return self._arrive(self.articles.article(answer))

    def _arrive(self, article: Article) -> StepResult:
        title = article.title
        if title == self.target:
            self._go(article)
            return self._win(title, f"You have reached {title}: well done.")
        if not article.links and self.variant in ("oneback", "freenav"):
            self.turn = min(self.turn + 1, self.max_turns)
            self.went_back = True
            feedback = f"{title} has no links. You are back at {self.path[-1].title}, which cost a second turn."
            return self._move(title, feedback, 2 * _STEP, 2 * _STEP)
        self._go(article)
        if not article.links and not self._open_titles():
            return self._end("lost", f"{title} has no links, and so the game ends.{self._solution()}", 0.0, title)
        return self._move(title, f"You followed the link to {title}.", _STEP, 0.0)

    def _go(self, article: Article) -> None:
        self.path.append(article)
        self._begin()

    def _go_back(self) -> StepResult:
        if self.variant in ("noregrets", "eidetic"):
            return self._wrong("There is no way back in this game.", _WRONG)
        if len(self.path) < 2:
            return self._wrong("There is no article before this one.", _WRONG)
        if self.went_back and self.variant == "oneback":
            return self._wrong("You cannot go back twice in a row.", _WRONG)
        self.path.pop()
        self._begin()
        self.went_back = True
        return self._move(BACK, f"You went back to {self.path[-1].title}.", _STEP, _STEP)

    def _turn_to(self, part: int) -> StepResult:
        parts = _num_parts(len(self._open_titles()), self.links_per_part)
        if not 1 <= part <= parts:
            return self._wrong(f"There is no part {part} of the links.")
        self.part = part
        return self._move(f"<LINKS {part}>", f"This is part {part} of the links.", _STEP, 0.0)

    def _wrong(self, feedback: str, at_limit: float = 0.0) -> StepResult:
        return self._move(None, f"{feedback} The turn is lost.", _WRONG, at_limit)

    def _solution(self) -> str:
        return f" A shortest way was: {' → '.join(self.articles.way(self.start, self.target))}."

    def _gold_answer(self) -> str | None:
        try:
            way = self.articles.way(self.path[-1].title, self.target)
        except ArgumentError:  # in a collection with one-way links, the target may be out of reach by now
            return None
        return way[min(1, len(way) - 1)]

    def _random_answer(self) -> str:
        """Draw a link that can be followed; where there is none, as after the end, repeat the target."""
        titles = self._open_titles()
        return titles[int(self.action_random.random() * len(titles))] if titles else self.target

    def _drawing(self) -> str:
        here = self.path[-1]
        steps = [article.title for article in self.path[-6:-1]]
        way = " → ".join([*(["…"] if len(self.path) > 6 else []), *steps, ""])
        shown = islice(self._open_titles(), (self.part - 1) * self.links_per_part, self.part * self.links_per_part)
        summary = _summary(here, self._summary_length, self._summary_unit)
        return "\n".join(
            [
                f"{painted(way, 'dim')}{painted(here.title, 'bold')}   (target: {painted(self.target, 'green')})",
                *textwrap.wrap(summary, 78),
                *_columns(shown, self.target),
            ]
        )


def _summary(article: Article, length: int, unit: str) -> str:
    """Return the beginning of an article's text."""
    text = article.text
    if unit == "characters":
        return text if len(text) <= length else f"{text[:length].rstrip()}…"
    pieces = text.split() if unit == "words" else _SENTENCE_END.split(text)
    return " ".join(pieces) if len(pieces) <= length else f"{' '.join(pieces[:length])} …"


def _listed(titles: tuple[str, ...], what: str, part: int, per_part: int) -> str:
    """Return one part of a list of links, a line each, with a heading that says what there is."""
    if not titles:
        return f"{what}: none\n"
    parts = _num_parts(len(titles), per_part)
    first = (part - 1) * per_part
    lines = "".join(f"- {title}\n" for title in titles[first : first + per_part])
    if parts == 1:
        return f"{what}:\n{lines}"
    other = part % parts + 1
    return (
        f"{what}, part {part} of {parts} ({len(titles)} links in all; \\boxed{{<LINKS {other}>}} shows part {other} "
        f"and costs a turn):\n{lines}"
    )


def _num_parts(count: int, per_part: int) -> int:
    return max(1, -(-count // per_part))


def _hint(answer: str, titles: tuple[str, ...]) -> str:
    """Name a link that the answer may have meant; ``""`` without one."""
    if len(answer) > _LONGEST_HINT:
        return ""
    wanted = answer.replace("_", " ").casefold()
    same = (title for title in titles if title.casefold() == wanted)
    alike = (title for title in titles if wanted in title.casefold())
    near = next(chain(same, alike), None)
    return f" Did you mean {near!r}?" if near is not None else ""


def _columns(titles: Iterable[str], target: str) -> Iterator[str]:
    """Lay titles out in lines of three for a person, the target among them in another colour."""
    width, row = 26, ""
    for number, title in enumerate(titles, start=1):
        colour = "green" if title == target else "cyan"
        row += painted(title, colour) + " " * max(1, width - len(title))
        if number % 3 == 0:
            yield row.rstrip()
            row = ""
    if row:
        yield row.rstrip()


def _checked_summary(value: object) -> tuple[int, str]:
    if isinstance(value, tuple | list) and len(value) == 2:
        length, unit = value
        if type(length) is int and length >= 0 and unit in _UNITS:
            return length, unit
    raise ArgumentError(f"page_summary_length must be a pair such as (100, 'characters'), not {value!r}")


def _checked_pair(options: dict[str, Any]) -> tuple[str, str]:
    if set(options) != {"start", "target"} or not all(isinstance(title, str) for title in options.values()):
        raise ArgumentError(f"options of WikiGame are 'start' and 'target', both titles, not {options!r:.200}")
    return options["start"], options["target"]


def _check_distances(nearest: object, farthest: object, max_turns: int | None) -> None:
    if type(nearest) is not int or type(farthest) is not int or not 1 <= nearest <= farthest <= _FARTHEST:
        raise ArgumentError(
            f"min_distance and max_distance must be whole numbers, 1 <= min_distance <= max_distance <= {_FARTHEST}, "
            f"not {nearest!r} and {farthest!r}"
        )
    if nearest > (max_turns or min(_TURN_LIMITS)):
        raise ArgumentError(f"min_distance={nearest} cannot be travelled in {max_turns or min(_TURN_LIMITS)} turns")
