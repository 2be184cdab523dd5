r"""Tower of Hanoi: move a tower of disks from peg A to peg C."""

from __future__ import annotations

import re
from collections.abc import Mapping

from gem_core.errors import ArgumentError
from gem_core.types import StepResult
from gem_games.cheap_random import CheapRandom
from gem_games.game import Game, check_whole, painted, sizes_to_draw

_SIZES = (3, 10), (4, 20), (5, 35)
_MOST_DISKS = 20
_DISK_COLOURS = "cyan", "yellow", "magenta", "green", "blue", "red"
_TOWERS = ["".join(f" {disk}" for disk in range(height, 0, -1)) for height in range(_MOST_DISKS + 1)]
# Possessive (*+): with plain stars, a few thousand spaces would take seconds to refuse.
_MOVE = re.compile(r"([ABCabc])\s*+,?\s*+([ABCabc])", re.ASCII)


class TowerOfHanoiEnv(Game):
    r"""Move disks one by one with moves such as ``\boxed{A C}``, never a larger one onto a smaller one.

    - All disks on peg C: reward 1, the game is won.
    - Another move: reward 0.
    - A move from an empty peg, to the peg it comes from, or onto a smaller disk: reward 0, nothing moves.
    - In the last turn, whichever of these it is: the share of the disks that are on peg C.
    - Not two pegs, with a space, a comma or nothing between them: reward -0.1, the game is over.

    Args:
        num_disks: Height of the tower.
        max_turns: Moves allowed; ``2**num_disks - 1`` are needed.
        format_error_ends: See ``Game``.

    Where one of the first two is None, a size is drawn from (3, 10), (4, 20) and (5, 35) and what was given replaces
    its part of it; sizes that cannot be solved are left out.

    Source: parameters and rewards of gem-llm's game of this name, https://github.com/axon-rl/gem.
    """

    unreadable = "does not name two of the pegs A, B and C."

    def __init__(
        self, num_disks: int | None = 3, max_turns: int | None = 100, *, format_error_ends: bool = True
    ) -> None:
        super().__init__(format_error_ends=format_error_ends)
        check_whole("num_disks", num_disks, 1, _MOST_DISKS)
        check_whole("max_turns", max_turns, 1, 10**15)
        given = num_disks, max_turns
        self._sizes: list[tuple[int, int]] = [
            (disks, turns)
            for disks, turns in sizes_to_draw(_SIZES, given)
            if None not in given or 2**disks - 1 <= turns
        ]
        if not self._sizes:
            raise ArgumentError(
                f"no tower can be drawn that num_disks={num_disks} and max_turns={max_turns} leave solvable; give both"
            )
        self.num_disks, self.max_turns = self._sizes[0]
        self.pegs: dict[str, list[int]] = {"A": [], "B": [], "C": []}
        self._rows = {"A": "", "B": "", "C": ""}

    def _deal(self, draws: CheapRandom) -> None:
        if len(self._sizes) > 1:
            self.num_disks, self.max_turns = self._sizes[draws.below(len(self._sizes))]
        self.pegs = {"A": list(range(self.num_disks, 0, -1)), "B": [], "C": []}
        self._rows = {"A": _TOWERS[self.num_disks], "B": "", "C": ""}

    def _rules(self) -> str:
        return (
            f"Tower of Hanoi: move all {self.num_disks} disks from peg A to peg C.\n"
            "A move takes the top disk of one peg and puts it on top of another. A disk may not lie on a smaller one; "
            "a move that breaks the rules costs a turn and moves nothing.\n"
            "Write your move inside \\boxed{}, first the peg to take from, then the peg to put on.\n"
        )

    def _situation(self) -> str:
        rows = self._rows
        return (
            "\nAll disks must go to peg C. The pegs, each from the bottom to the top, disk 1 being the smallest:\n"
            f"A:{rows['A'] or ' empty'}\nB:{rows['B'] or ' empty'}\nC:{rows['C'] or ' empty'}\n"
            + self._turns_left("Answer like \\boxed{A B}: from peg A to peg B.")
        )

    def _read(self, answer: str) -> tuple[str, str] | None:
        match = _MOVE.fullmatch(answer)
        return None if match is None else (match[1].upper(), match[2].upper())

    def _play(self, pegs: tuple[str, str]) -> StepResult:
        source, target = pegs
        fault = self._fault(source, target)
        if fault:
            return self._invalid(fault, self._share_done())
        disk = self._carry(source, target)
        move, feedback = f"{source} {target}", f"Disk {disk} went from peg {source} to peg {target}."
        share = self._share_done()
        if share == 1.0:
            return self._win(move, f"{feedback} The tower stands on peg C: well done.")
        return self._move(move, feedback, 0.0, share)

    def _carry(self, source: str, target: str) -> int:
        """Move the top disk of one peg to another, and return it."""
        disk = self.pegs[source].pop()
        self.pegs[target].append(disk)
        label = f" {disk}"
        self._rows[source] = self._rows[source].removesuffix(label)
        self._rows[target] += label
        return disk

    def _fault(self, source: str, target: str) -> str:
        """Say why a move breaks the rules; ``""`` if it does not."""
        origin, goal = self.pegs[source], self.pegs[target]
        if not origin:
            return f"Peg {source} is empty."
        if goal and goal[-1] <= origin[-1]:
            if source == target:
                return "A move must go to another peg."
            return f"Disk {origin[-1]} may not lie on disk {goal[-1]}, which is smaller."
        return ""

    def _share_done(self) -> float:
        return len(self.pegs["C"]) / self.num_disks

    def _gold_answer(self) -> str | None:
        return " ".join(best_move({disk: peg for peg, disks in self.pegs.items() for disk in disks}))

    def _random_answer(self) -> str:
        """Draw a legal move."""
        moves = [f"{a} {b}" for a in "ABC" for b in "ABC" if not self._fault(a, b)]
        return moves[int(self.action_random.random() * len(moves))]

    def _drawing(self) -> str:
        width = 2 * self.num_disks + 1
        rows = []
        for level in range(self.num_disks - 1, -1, -1):
            sizes = [peg[level] if level < len(peg) else 0 for peg in self.pegs.values()]
            rows.append(" ".join(_disk(size, width) for size in sizes))
        rows.append(" ".join("─" * width for _ in self.pegs))
        rows.append(" ".join(peg.center(width) for peg in self.pegs))
        return "\n".join(row.rstrip() for row in rows)


def best_move(place: Mapping[int, str]) -> tuple[str, str]:
    """Return the first of the fewest moves that bring all disks to peg C: from which peg to which.

    Args:
        place: The peg of each disk.
    """
    # A disk that must move needs all smaller ones on the third peg; so the last one found can move at once.
    goal, source, target = "C", "A", "C"
    for disk in sorted(place, reverse=True):
        if place[disk] != goal:
            source, target = place[disk], goal
            goal = next(name for name in "ABC" if name not in (source, target))
    return source, target


def _disk(size: int, width: int) -> str:
    """Draw a disk, or the bare peg for size 0, in the middle of a width."""
    if not size:
        return painted("│", "dim").join([" " * (width // 2)] * 2)
    margin = " " * ((width - 2 * size - 1) // 2)
    return painted("█" * (2 * size + 1), _DISK_COLOURS[size % len(_DISK_COLOURS)]).join([margin, margin])
