"""Dumps in the forms that there are, and what is said of those that cannot be restored."""

from __future__ import annotations

import gzip

import pytest
from mcpmark_helping import CONNECT, needs_postgres, write_task

from gem_mcpmark import PostgresError, read_tasks

pytestmark = needs_postgres

# As newer versions write it, and with an owner that there is not.
DUMP = """\\restrict abc
SET transaction_timeout = 0;
SET statement_timeout = 0;
CREATE TABLE public.fruit (id integer, name text);
ALTER TABLE public.fruit OWNER TO grocer;
COPY public.fruit (id, name) FROM stdin;
1\tpear
2\tERROR:  no error
\\.
GRANT ALL ON TABLE public.fruit TO grocer;
"""
COUNT = f"{CONNECT}cursor.execute('SELECT count(*), current_user FROM fruit')\nprint(*cursor.fetchone())\n"


@pytest.fixture
def task(tmp_path, monkeypatch):
    """A task that needs the data of ``shop``."""
    monkeypatch.delenv("GEM_MCPMARK_POSTGRES", raising=False)
    (task,) = read_tasks(write_task(tmp_path, verify=COUNT, prepare=None))
    return task


def rows(task, folder):
    """Return how many rows the restored table has."""
    from gem_mcpmark.episode import EpisodeDatabase

    episode = EpisodeDatabase(task, folder)
    try:
        return int(episode.verify(60).output.split()[0])
    finally:
        episode.close()


@pytest.mark.thorough
def test_a_file_of_sql_plain_and_packed(task, tmp_path):
    (tmp_path / "shop.sql").write_text(DUMP)
    assert rows(task, tmp_path) == 2
    packed = tmp_path / "packed"
    packed.mkdir()
    (packed / "shop.sql.gz").write_bytes(gzip.compress(DUMP.encode()))
    assert rows(task, packed) == 2


@pytest.mark.parametrize(
    ("sql", "words"),
    [
        ("CREATE TABLE public.fruit (id no_such_type);", 'type "no_such_type" does not exist'),
        ("CREATE EXTENSION no_such_extension; CREATE TABLE public.fruit (id int);", "no_such_extension"),
        ("SELECT 1;", "has no table"),
        ("CREATE DATABASE shop;\nCREATE TABLE public.fruit (id int);", "permission denied to create database"),
    ],
)
def test_a_dump_that_lacks_something_is_an_error(task, tmp_path, sql, words):
    """Never a database with holes."""
    (tmp_path / "shop.sql").write_text(sql)
    with pytest.raises(PostgresError, match=words):
        rows(task, tmp_path)
