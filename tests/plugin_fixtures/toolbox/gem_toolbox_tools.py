"""The heavy part of the toolbox: a vault with two locks, and two tools that are known by their JSON Schemas alone."""

import pydantic

from gem_core import DatasetEnv, Tool, ToolResult
from gem_core.errors import ArgumentError

KEYS = {"north": "brass", "south": "iron"}


class Vault(Tool):
    """Opens with both keys, one after the other, within an episode."""

    name = "vault"
    description = "Tries a key in a lock, and shows the word once both locks are open."
    concurrency = "inline"

    class Parameters(pydantic.BaseModel):
        """A lock and a key."""

        lock: str = pydantic.Field(description="north or south")
        key: str = pydantic.Field(description="what the key is made of")

    def open(self):
        """Begin with all locks shut."""
        return []

    def call(self, arguments, session):
        """Turn a key."""
        if KEYS.get(arguments.lock) != arguments.key:
            return ToolResult("The key does not turn.", failed=True)
        session.append(arguments.lock)
        return "The word is 'heron'." if set(session) == set(KEYS) else "One lock is open."


class Listed(Tool):
    """A tool of a list: name, description and schema come at run time."""

    concurrency = "inline"

    def __init__(self, name, description, schema, answer):
        self.name = name
        self.description = description
        self.schema_of_arguments = schema
        self.answer = answer

    def parameters_schema(self):
        """Return the schema as it came."""
        return dict(self.schema_of_arguments)

    def validate(self, arguments):
        """Return the arguments, if all that are required are there."""
        for name in self.schema_of_arguments.get("required", []):
            if name not in arguments:
                raise ArgumentError(f"{name} is missing")
        return dict(arguments)

    def call(self, arguments, session):
        """Answer with the arguments filled in."""
        return self.answer(arguments)


def make_box(prefix=""):
    """Return two tools."""
    text = {"type": "object", "properties": {"lock": {"type": "string", "description": "which"}}, "required": ["lock"]}
    return [
        Listed(
            f"{prefix}look", "Looks at a lock.", text, lambda asked: KEYS.get(asked["lock"], "there is no such lock")
        ),
        Listed(f"{prefix}count", "Counts the locks.", {"type": "object"}, lambda asked: str(len(KEYS))),
    ]


class VaultEnv(DatasetEnv):
    """Asks for the word in the vault."""

    def __init__(self):
        super().__init__(
            [{"question": "Which word is in the vault? It has a north and a south lock.", "answer": "heron"}]
        )
