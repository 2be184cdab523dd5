"""Reward files and reports of tests: right, wrong, hostile, and any bytes at all."""

from __future__ import annotations

import json
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gem_terminal.verifying.results import RewardFileError, read_report, read_rewards


@pytest.mark.parametrize(
    ("content", "value"),
    [(b"1", 1.0), (b" 0.5\n", 0.5), (b"-2", -2.0), (b"\xef\xbb\xbf1.0\r\n", 1.0), (b"1e-3", 0.001)],
)
def test_reward_txt_is_one_number(content: bytes, value: float) -> None:
    assert read_rewards({"reward.txt": content}) == {"reward": value}


NO_NUMBERS = [b"", b"  \n", b"\xef\xbb\xbf", b"yes", b"1 2", b"nan", b"-inf", b"1e999", b"[1]", b"\xff\xfe", b"1,0"]


@pytest.mark.parametrize("content", [*NO_NUMBERS, b"9" * 2_000_000])
def test_reward_txt_that_is_no_number_cannot_be_read(content: bytes) -> None:
    with pytest.raises(RewardFileError, match=r"^reward\.txt "):
        read_rewards({"reward.txt": content})


def test_reward_json_takes_precedence_over_reward_txt() -> None:
    assert read_rewards({"reward.txt": b"1", "reward.json": b'{"reward": 0}'}) == {"reward": 0.0}


def test_broken_reward_json_is_not_replaced_by_reward_txt() -> None:
    with pytest.raises(RewardFileError, match=r"reward\.json is empty"):
        read_rewards({"reward.json": b"", "reward.txt": b"1"})


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (b"{}", "dict"),
        (b"[1]", "list"),
        (b"1", "int"),
        (b'{"reward": "1"}', "'1' for 'reward'"),
        (b'{"reward": {"reward": 1}}', "dict for 'reward'"),
        (b'{"reward": null}', "NoneType for 'reward'"),
        (b'{"reward": NaN}', "nan"),
        (b'{"a": 1, "b": -Infinity}', "-inf"),
        (b'{"reward": 1e999}', "inf"),
        (b'{"reward": 1' + b"0" * 400 + b"}", "one number"),
        (b"[" * 100_000, "not JSON"),
        (b'{"a":' * 100_000, "not JSON"),
        (b'{"reward": ' + b"9" * 5000 + b"}", "not JSON"),
        (b"{'a': 1}", "not JSON"),
    ],
)
def test_reward_json_that_is_no_flat_object_of_numbers_cannot_be_read(content: bytes, reason: str) -> None:
    with pytest.raises(RewardFileError, match=r"^reward\.json ") as caught:
        read_rewards({"reward.json": content})
    assert reason in str(caught.value)


@given(
    st.binary(max_size=60)
    | st.recursive(st.floats() | st.text() | st.none(), st.lists).map(lambda v: json.dumps(v).encode())
)
def test_any_bytes_give_finite_numbers_or_the_error_of_reward_files(content: bytes) -> None:
    for name in ("reward.json", "reward.txt"):
        try:
            rewards = read_rewards({name: content})
        except RewardFileError:
            continue
        assert rewards
        assert all(math.isfinite(value) for value in rewards.values())


CTRF = {
    "results": {
        "tests": [
            {"name": "test_a", "status": "passed", "message": "x"},
            {"name": "test_b", "status": "failed", "message": "assert 0"},
            {"name": "test_c", "status": "skipped"},
            {"name": "test_a", "status": "failed"},
            {"name": 3, "status": "passed"},
            "nonsense",
        ]
    }
}


def test_ctrf_names_the_tests_and_a_name_that_failed_once_has_failed() -> None:
    tests = read_report({"ctrf.json": json.dumps(CTRF).encode()})
    assert [(test.name, test.passed, test.message) for test in tests] == [
        ("test_a", False, ""),
        ("test_b", False, "assert 0"),
        ("test_c", True, ""),
    ]


BROKEN = [b"", b"[" * 100_000, b"[1]", b'{"results": {"tests": 5}}']


@pytest.mark.parametrize("files", [{}, *({"ctrf.json": content} for content in BROKEN)])
def test_broken_report_names_no_tests(files: dict[str, bytes]) -> None:
    assert read_report(files) == ()


@given(st.binary(max_size=80))
def test_any_bytes_are_no_crash_as_a_report(content: bytes) -> None:
    assert isinstance(read_report({"ctrf.json": content}), tuple)
