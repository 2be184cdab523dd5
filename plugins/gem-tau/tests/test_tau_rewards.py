"""The reward, and the hash of a database that it goes by."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from pathlib import Path

import pytest
from tau_folders import CANCEL, MOVE, tau2_task, tau_task, write_tau, write_tau2

from gem_tau import Action, Database, fork, read_folder, replay, reward
from gem_tau.database import Digest


def test_the_final_database_must_be_that_of_the_reference_actions(tmp_path: Path) -> None:
    """Whatever led there; and a database with a change too many is another."""
    task_set = read_folder(write_tau(tmp_path, tau_task(CANCEL)))
    (task,) = task_set.tasks
    database = fork(task_set.database)
    assert reward(task_set, task, database, []) == (0.0, {"DB": 0.0, "COMMUNICATE": 1.0})
    task_set.domain.call(database, "get_order_details", {"order_id": "#W1"})
    task_set.domain.call(database, CANCEL["name"], CANCEL["kwargs"])
    assert reward(task_set, task, database, []) == (1.0, {"DB": 1.0, "COMMUNICATE": 1.0})
    task_set.domain.call(database, MOVE["name"], MOVE["kwargs"])
    assert reward(task_set, task, database, []).value == 0.0


@pytest.mark.parametrize(
    ("said", "expected"),
    [
        (["It is 1,234.5 in all", "and the Red one."], 1.0),
        (["1234.5 RED"], 1.0),
        (["1234.5"], 0.0),
        (["re", "d 1234.5"], 0.0),
        ([], 0.0),
    ],
)
def test_each_output_must_be_in_something_that_was_said(tmp_path: Path, said: list[str], expected: float) -> None:
    """In any message, whatever the case, and without the commas of the message."""
    task_set = read_folder(write_tau(tmp_path, tau_task(outputs=("1234.5", "red"))))
    assert reward(task_set, task_set.tasks[0], fork(task_set.database), said).value == expected


def test_tau2_bench_multiplies_what_its_basis_names(tmp_path: Path) -> None:
    """Reference actions are compared with the calls, by the arguments that are named; by all where none are."""
    written = tau2_task("a", MOVE, communicate_info=["never said"], reward_basis=["DB", "ACTION"])
    written["evaluation_criteria"]["actions"][0]["compare_args"] = ["user_id"]
    task_set = read_folder(write_tau2(tmp_path, written))
    (task,) = task_set.tasks
    database = replay(task_set, task.actions)
    assert reward(task_set, task, database, []) == (0.0, {"DB": 1.0, "ACTION": 0.0})
    calls = [Action("modify_user_address", {"user_id": "ann_lee_1", "zip": "1"})]
    assert reward(task_set, task, database, [], calls).value == 1.0
    strict = dataclasses.replace(task, actions=(dataclasses.replace(task.actions[0], compare=None),))
    assert reward(task_set, strict, database, [], calls).value == 0.0
    assert reward(task_set, strict, database, [], strict.actions).value == 1.0


def test_without_criteria_there_is_nothing_to_fail(tmp_path: Path) -> None:
    """And without reference actions no database to compare with."""
    free, talk = tau2_task("a"), tau2_task("b", communicate_info=["red"])
    free["evaluation_criteria"] = None
    talk["evaluation_criteria"]["actions"] = None
    task_set = read_folder(write_tau2(tmp_path, free, talk))
    assert [task.reward_basis for task in task_set.tasks] == [(), ("COMMUNICATE",)]
    assert reward(task_set, task_set.tasks[0], fork(task_set.database), []) == (1.0, {})


def test_the_hash_is_of_the_benchmarks_text() -> None:
    """Nested tuples sorted by key, of one element too; or JSON with sorted keys."""
    database: Database = {"b": {"y": {"k": [1, {"z": True, "a": None}]}, "x": {}}, "a": {"only": {"p": 1.0}}}
    tuples = "(('a', (('only', (('p', 1.0),)),)), ('b', (('x', ()), ('y', (('k', (1, (('a', None), ('z', True)))),)))))"
    assert Digest(database, "tuples")(database) == hashlib.sha256(tuples.encode()).hexdigest()
    text = '{"a": {"only": {"p": 1.0}}, "b": {"x": {}, "y": {"k": [1, {"a": null, "z": true}]}}}'
    assert Digest(database, "json")(database) == hashlib.sha256(text.encode()).hexdigest()


def test_databases_are_the_same_where_their_hashes_are(tmp_path: Path) -> None:
    """An equal copy is; 5 and 5.0 are not, nor is a database with a record more."""
    task_set = read_folder(write_tau(tmp_path))
    digest, database = task_set.digest, fork(task_set.database)
    card = {"source": "gift_card", "balance": 5, "id": "gift_card_1"}
    user = {**database["users"]["ann_lee_1"], "payment_methods": {"gift_card_1": card}}
    for record, same in ((user, True), ({**user, "payment_methods": {"gift_card_1": {**card, "balance": 5.0}}}, False)):
        first, second = fork(database), fork(database)
        first["users"]["ann_lee_1"], second["users"]["ann_lee_1"] = user, json.loads(json.dumps(record))
        assert digest.same(first, second) is same
        assert (digest(first) == digest(second)) is same
    more = fork(database)
    more["users"]["bob"] = user
    assert not digest.same(database, more)
