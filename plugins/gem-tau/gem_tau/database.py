"""A database: tables of records, all plain data. Databases of one data folder share the records that nobody changed."""

from __future__ import annotations

import copy
import json
from hashlib import sha256
from typing import Any, Literal

Record = dict[str, Any]
Database = dict[str, dict[str, Record]]
"""Table name to record id to record. A record is never changed in place: a tool makes a copy by ``own`` first."""


def fork(database: Database) -> Database:
    """Return a database that starts with the records of another, and can be changed without changing that one."""
    return {name: dict(records) for name, records in database.items()}


def own(database: Database, table: str, key: str) -> Record:
    """Put a copy of a record in its place and return it, to be changed.

    Raises:
        KeyError: There is no such record.
    """
    record = copy.deepcopy(database[table][key])
    database[table][key] = record
    return record


class Digest:
    """Computes the hash of a database as the benchmark does, from texts of the original records made once.

    Args:
        original: What all other databases are forks of.
        form: What is hashed: ``"tuples"`` is Python's text of nested tuples sorted by key (tau-bench), ``"json"`` is
            JSON with sorted keys (tau2-bench).
    """

    def __init__(self, original: Database, form: Literal["tuples", "json"]) -> None:
        self._original = original
        self._record_text, self._join = (_tuple_text, _join_tuples) if form == "tuples" else (_json_text, _join_json)
        self._texts = {
            name: {key: self._record_text(record) for key, record in records.items()}
            for name, records in original.items()
        }

    def __call__(self, database: Database) -> str:
        """Return the SHA-256 of a database's text, in hexadecimal."""
        tables = {name: self._join(self._table_texts(name, records)) for name, records in database.items()}
        return sha256(self._join(tables).encode()).hexdigest()

    def same(self, first: Database, second: Database) -> bool:
        """Return whether two databases have the same text, and so the same hash; quicker than two hashes."""
        return first.keys() == second.keys() and all(
            records.keys() == second[name].keys()
            and all(
                record is second[name][key] or self._record_text(record) == self._record_text(second[name][key])
                for key, record in records.items()
            )
            for name, records in first.items()
        )

    def _table_texts(self, name: str, records: dict[str, Record]) -> dict[str, str]:
        originals, texts = self._original[name], self._texts[name]
        return {
            key: texts[key] if record is originals.get(key) else self._record_text(record)
            for key, record in records.items()
        }


def _tuple_text(value: object) -> str:
    return repr(_as_tuples(value))


def _as_tuples(value: object) -> object:
    if isinstance(value, dict):
        return tuple((key, _as_tuples(part)) for key, part in sorted(value.items()))
    if isinstance(value, list):
        return tuple(_as_tuples(part) for part in value)
    return value


def _join_tuples(texts: dict[str, str]) -> str:
    pairs = [f"({key!r}, {text})" for key, text in sorted(texts.items())]
    return f"({', '.join(pairs)}{',' if len(pairs) == 1 else ''})"


def _json_text(value: object) -> str:
    return json.dumps(value, sort_keys=True)


def _join_json(texts: dict[str, str]) -> str:
    return "{" + ", ".join(f"{json.dumps(key)}: {text}" for key, text in sorted(texts.items())) + "}"
