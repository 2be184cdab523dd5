"""Data folders: what is read, and what is said of one that cannot be."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from tau_folders import CANCEL, MOVE, tau2_task, tau_task, write_tau, write_tau2

from gem_core.errors import DatasetError
from gem_tau import Action, read_folder


def test_a_folder_of_tau_bench(tmp_path: Path) -> None:
    """Every file of tasks is a split, and its tasks are numbered."""
    write_tau(tmp_path, tau_task(CANCEL, outputs=("30.1",)), tau_task())
    (tmp_path / "tasks_dev.json").write_text(json.dumps([tau_task()]))
    task_set = read_folder(str(tmp_path))
    assert [task.id for task in task_set.tasks] == ["dev-0", "test-0", "test-1"]
    assert [task.id for task in read_folder(tmp_path, split="dev").tasks] == ["dev-0"]
    task = task_set.tasks[1]
    assert (task.instruction, task.outputs) == ("You are Ann.", ("30.1",))
    assert task.actions == (Action("cancel_pending_order", {"order_id": "#W1", "reason": "no longer needed"}),)
    assert (task_set.policy, len(task_set.tools), task_set.domain.name) == ("Be kind.", 16, "tau-retail")
    (tmp_path / "tools.json").write_text(
        '[{"type": "function", "function": {"name": "think"}}]'
    )  # which the folder's own descriptions replace
    assert [tool["function"]["name"] for tool in read_folder(tmp_path).tools] == ["think"]


def test_a_checkout_of_tau_bench_is_read_and_not_run(tmp_path: Path) -> None:
    """Its tasks are Python, its tables are in a folder of their own, and its policy is wiki.md."""
    retail = write_tau(tmp_path / "tau_bench" / "envs" / "retail", tau_task(CANCEL, outputs=("30.1",)))
    plain = read_folder(retail)
    (retail / "data").mkdir()
    for name in ("orders.json", "products.json", "users.json"):
        (retail / name).rename(retail / "data" / name)
    (retail / "policy.md").rename(retail / "wiki.md")
    (retail / "tasks_test.json").unlink()
    task = (
        'Task(annotator="0", user_id="ann_lee_1", instruction="You are " "Ann.", actions=[Action(name='
        '"cancel_pending_order", kwargs={"order_id": "#W1", "reason": "no longer needed"})], outputs=["30.1"])'
    )
    (retail / "tasks_test.py").write_text(f"from nowhere import Task, Action\nTASKS = [{task}]\n")
    (retail / "tools").mkdir()
    for tool in plain.tools:
        words = {**tool, "function": {**tool["function"], "description": "Theirs."}}
        code = f"class Tool(Base):\n    @staticmethod\n    def get_info():\n        return {words!r}\n\nnowhere()\n"
        (retail / "tools" / f"{tool['function']['name']}.py").write_text(code)
    read = read_folder(tmp_path)
    assert (read.tasks, read.policy, read.database) == (plain.tasks, plain.policy, plain.database)
    assert {tool["function"]["description"] for tool in read.tools} == {"Theirs."}
    assert (plain.tools_from, read.tools_from, len(read.tools)) == ("gem-tau", "tools/*.py", 16)

    (retail / "tools" / "think.py").write_text("def get_info():\n    return input()\n")
    with pytest.raises(DatasetError, match=r"think\.py has other code than get_info\(\) with a literal: malformed"):
        read_folder(tmp_path)
    shutil.rmtree(retail / "tools")

    (retail / "tasks_test.py").write_text("TASKS = [Task(user_id=input())]\n")
    with pytest.raises(DatasetError, match=r"tasks_test\.py has other code than a list of Task\(\.\.\.\): malformed"):
        read_folder(tmp_path)


def test_a_folder_of_tau2_bench(tmp_path: Path) -> None:
    """Missing fields are null, numbers are floats, and the user's instructions are one text."""
    write_tau2(tmp_path, tau2_task("a", CANCEL, communicate_info=["30.1"]), tau2_task("b"))
    task_set = read_folder(tmp_path)
    assert (task_set.domain.name, len(task_set.tools)) == ("tau2-retail", 16)
    assert task_set.database["orders"]["#W1"]["cancel_reason"] is None
    assert repr(task_set.database["users"]["ann_lee_1"]["payment_methods"]["gift_card_1"]["balance"]) == "5.0"
    task, other = task_set.tasks
    assert task.instruction == "Why you write:\nA lamp.\n\nHow you behave:\nNod."
    assert (task.id, task.outputs, task.reward_basis, other.id) == ("a", ("30.1",), ("DB", "COMMUNICATE"), "b")
    assert [each.id for each in read_folder(tmp_path, split="test").tasks] == ["a"]


def test_tasks_of_tau2_bench_that_cannot_be_judged_are_left_out_and_named(tmp_path: Path) -> None:
    """A judge counts only where the reward is made of what it says."""
    basis = ["DB", "NL_ASSERTION"]
    by_user = tau2_task("user", CANCEL)
    by_user["evaluation_criteria"]["actions"][0]["requestor"] = "user"
    started = tau2_task("started")
    started["initial_state"] = {"initialization_data": {"agent_data": {"orders": {}}}}
    write_tau2(
        tmp_path,
        tau2_task("judged", nl_assertions=["It is polite."], reward_basis=basis),
        tau2_task("nothing to judge", nl_assertions=[], reward_basis=basis),
        tau2_task("not counted", nl_assertions=["It is polite."], reward_basis=["DB"]),
        tau2_task("asserted", env_assertions=[{"func_name": "x"}], reward_basis=["ENV_ASSERTION"]),
        by_user,
        started,
    )
    task_set = read_folder(tmp_path)
    assert [task.id for task in task_set.tasks] == ["nothing to judge", "not counted"]
    assert task_set.left_out == {
        "judged": "a model would have to judge it (nl_assertions)",
        "asserted": "it asserts what the tools of its domain do not tell (env_assertions)",
        "user": "its user has tools",
        "started": "it begins in a state of its own (initial_state)",
    }


@pytest.mark.parametrize(
    ("file", "text", "expected"),
    [
        ("users.json", None, "users.json is missing; a folder of"),
        ("policy.md", None, "policy.md is missing; a folder of"),
        ("orders.json", '{"#W1": ', "orders.json is not JSON: Expecting value"),
        ("orders.json", "[" * 100_000, "orders.json is not JSON: "),
        ("orders.json", b"\xff", "orders.json cannot be read: 'utf-8' codec"),
        ("orders.json", '{"#W1": {}}', "orders.json: #W1.order_id: Field required"),
        ("users.json", "[]", "users.json: Input should be a valid dictionary"),
        ("tasks_test.json", '[{"user_id": "a"}]', "tasks_test.json: 0.instruction: Field required"),
        ("tasks_dev.py", "TASKS = [Task(actions={[]: 1})]", "tasks_dev.py has other code than a list of Task(...): "),
        ("tasks_dev.py", "TASKS = " + "-" * 100_000 + "1", "tasks_dev.py has other code than a list of Task(...)"),
        ("tools.json", '[{"function": {}}]', "tools.json: 0.function.name: Field required"),
        (
            "tools.json",
            '[{"function": {"name": "think", "parameters": 5}}]',
            "tools.json: 0.function.parameters: Input",
        ),
        ("tasks_test.json", None, "has no tasks_test.json, tasks_train.json or tasks_dev.json"),
    ],
)
def test_a_malformed_file_is_named(tmp_path: Path, file: str, text: str | bytes | None, expected: str) -> None:
    write_tau(tmp_path)
    (tmp_path / file).unlink(missing_ok=True)
    if text is not None:
        (tmp_path / file).write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(DatasetError) as caught:
        read_folder(tmp_path)
    assert str(caught.value).removeprefix(str(tmp_path)).lstrip("/ ").startswith(expected)


def test_a_split_or_data_that_a_folder_does_not_have(tmp_path: Path) -> None:
    """The error names those that it has."""
    for folder, said in ((tmp_path / "nowhere", "no folder"), (tmp_path, "neither orders.json nor db.json")):
        with pytest.raises(DatasetError, match=said):
            read_folder(folder)
    with pytest.raises(DatasetError, match=r"has no split 'train'; it has: test$"):
        read_folder(write_tau(tmp_path / "one"), split="train")
    with pytest.raises(DatasetError, match=r"has no split 'train'; it has: test$"):
        read_folder(write_tau2(tmp_path / "two", tau2_task("a", MOVE)), split="train")
