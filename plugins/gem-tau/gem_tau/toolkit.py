"""What the tools of retail shops and airline have in common."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from gem_tau.calculator import evaluate, is_arithmetic
from gem_tau.database import Database

UserId = Annotated[str, Field(description="User id, such as 'sara_doe_496'.")]


class Toolkit:
    """The tools of a domain: its public methods, with the names and parameters of the original.

    A tool raises what the assistant reads after ``Error: ``; what it has changed until then stays changed, as in the
    originals.

    Args:
        database: What the tools work on: a fork of the original.
        tau2: Whether they are as in tau2-bench, else as in tau-bench.
    """

    def __init__(self, database: Database, *, tau2: bool = True) -> None:
        self._database, self._tau2 = database, tau2

    def calculate(
        self, expression: Annotated[str, Field(description="Arithmetic with numbers, + - * /, parentheses and blanks.")]
    ) -> str:
        """Compute an arithmetic expression."""
        if not is_arithmetic(expression):
            raise self._refusal("invalid characters in expression")
        return evaluate(expression)

    def transfer_to_human_agents(
        self, summary: Annotated[str, Field(description="The user's problem in short.")]
    ) -> str:
        """Hand the user over to a human agent, where the user asks for one or the tools and the policy cannot help."""
        return "Transfer successful"

    def _refusal(self, words: str) -> ValueError:
        """Return an error: tau2-bench says the same as tau-bench with a capital letter."""
        return ValueError(words[0].upper() + words[1:] if self._tau2 else words)
