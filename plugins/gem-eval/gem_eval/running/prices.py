"""What tokens cost, from a data file that users can replace."""

from __future__ import annotations

from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from gem_core.errors import ArgumentError

PRICES_FILE = Path(__file__).with_name("prices.json")
_Dollars = Annotated[float, Field(ge=0, allow_inf_nan=False)]


class Price(BaseModel):
    """What a model costs, in US dollars for a million tokens.

    Args:
        input: Tokens that it reads.
        output: Tokens that it writes.
        cached_input: Tokens that it reads and its server had kept; by default those of ``input``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    input: _Dollars
    output: _Dollars
    cached_input: _Dollars | None = None

    def of(self, usage: Mapping[str, Any]) -> float:
        """Return the cost of a response in dollars, from the token counts of its server."""
        read, written = _count(usage, "prompt_tokens"), _count(usage, "completion_tokens")
        details = usage.get("prompt_tokens_details")
        kept = min(_count(details, "cached_tokens"), read) if isinstance(details, Mapping) else 0
        kept_price = self.input if self.cached_input is None else self.cached_input
        return ((read - kept) * self.input + kept * kept_price + written * self.output) / 1e6


class Prices(BaseModel):
    """A file of prices.

    Args:
        as_of: When they held.
        unit: In words.
        models: The price of each model, by its name or a glob such as ``my-model-*``.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    models: dict[str, Price]
    as_of: str = ""
    unit: str = ""

    def find(self, agent: str) -> Price | None:
        """Return the price of an agent's model, as of ``openai:gpt-5-mini``; None where there is none.

        A dated version, as ``gpt-5-mini-2025-08-07``, has the price of its model.
        """
        name = agent.partition(":")[2] or agent
        if name in self.models:
            return self.models[name]
        fitting = [
            each for each in self.models if fnmatchcase(name, each) or fnmatchcase(name, f"{each}-20[0-9][0-9]-*")
        ]
        return self.models[max(fitting, key=len)] if fitting else None


def load_prices(path: str | Path | None = None) -> Prices:
    """Read a file of prices; by default the one that comes with the plugin.

    Raises:
        ArgumentError: It cannot be read, or has another form.
    """
    path = PRICES_FILE if path is None else Path(path)
    try:
        return Prices.model_validate_json(path.read_bytes())
    except OSError as error:
        raise ArgumentError(f"cannot read the prices in {path}: {error.strerror or error}") from error
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(map(str, first["loc"]))
        raise ArgumentError(f"{path} is no file of prices: {place}: {first['msg']}") from None


def _count(usage: Any, name: str) -> int:
    count = usage.get(name)
    return count if type(count) is int and count > 0 else 0
