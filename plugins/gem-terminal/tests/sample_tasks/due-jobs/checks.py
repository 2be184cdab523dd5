"""Checks of the program, with tables that it has not seen."""

import os
import tempfile

from sample_helpers import run


def due(table, when):
    """Return what the program says: exit code, commands, and the lines that it complains of."""
    with tempfile.TemporaryDirectory() as folder:
        path = os.path.join(folder, "table")
        with open(path, "w", encoding="utf-8") as file:
            file.write(table)
        done = run("python3", "/app/due.py", path, when)
    return done.exit_code, done.out.splitlines(), done.errors.splitlines()


def is_due(fields, when):
    exit_code, commands, errors = due(f"{fields} the command\n", when)
    assert (exit_code, errors) == (0, []), (fields, exit_code, errors)
    assert commands in ([], ["the command"]), (fields, commands)
    return bool(commands)


def test_numbers_lists_and_ranges():
    assert is_due("5 4 3 2 *", "2025-02-03 04:05")
    assert not is_due("5 4 3 2 *", "2025-02-03 04:06")
    assert not is_due("5 4 3 2 *", "2025-03-03 04:05")
    assert is_due("0,30 8-10,20 * * *", "2025-07-01 20:30")
    assert is_due("0,30 8-10,20 * * *", "2025-07-01 10:00")
    assert not is_due("0,30 8-10,20 * * *", "2025-07-01 11:00")


def test_steps_begin_at_the_first_value():
    assert is_due("*/20 * * * *", "2025-07-01 10:40")
    assert not is_due("*/20 * * * *", "2025-07-01 10:30")
    assert is_due("0 3-20/5 * * *", "2025-07-01 13:00")
    assert not is_due("0 3-20/5 * * *", "2025-07-01 15:00")
    assert is_due("0 0 */2 * *", "2025-07-31 00:00")
    assert not is_due("0 0 */2 * *", "2025-07-30 00:00")


def test_names_and_both_sundays():
    assert is_due("0 0 * JAN-mar *", "2025-03-09 00:00")
    assert not is_due("0 0 * JAN-mar *", "2025-04-09 00:00")
    for sunday in ("0", "7", "Sun", "5-7", "sun-mon"):
        assert is_due(f"0 0 * * {sunday}", "2025-03-09 00:00"), sunday
    assert not is_due("0 0 * * 1-6", "2025-03-09 00:00")
    assert is_due("0 0 * * tue,THU", "2025-03-06 00:00")


def test_one_of_the_two_days_is_enough():
    assert is_due("0 0 13 * fri", "2025-06-13 00:00")
    assert is_due("0 0 13 * fri", "2025-06-20 00:00")
    assert is_due("0 0 13 * fri", "2025-07-13 00:00")
    assert not is_due("0 0 13 * fri", "2025-07-14 00:00")
    assert not is_due("0 0 13 5 fri", "2025-06-13 00:00")
    assert not is_due("0 0 */2 * fri", "2025-06-06 00:00")
    assert not is_due("0 0 13 * */2", "2025-06-13 00:00")


def test_commands_are_printed_whole_and_in_order():
    table = "# first\n\n  # second\n* * * * * echo  'two  spaces' # not a comment\n  0\t0 * *\t* tabs\n"
    table += "1 * * * * not this\n0 0 1 * * last\n"
    assert due(table, "2025-08-01 00:00") == (0, ["echo  'two  spaces' # not a comment", "tabs", "last"], [])


def test_wrong_lines_are_named_and_passed_over():
    wrong = ["60 * * * * a", "* 24 * * * a", "* * 0 * * a", "* * * 13 * a", "* * * * 8 a", "9-3 * * * * a"]
    wrong += [
        "*/0 * * * * a",
        "* * * * *",
        "x * * * * a",
        "* * mon * * a",
        "1,,2 * * * * a",
        "-1 * * * * a",
        "5/2/1 * * * * a",
    ]
    table = "* * * * * before\n" + "\n".join(wrong) + "\n* * * * * after\n"
    exit_code, commands, errors = due(table, "2025-08-01 00:00")
    assert commands == ["before", "after"]
    assert errors == [f"line {number}: invalid" for number in range(2, len(wrong) + 2)]
    assert exit_code == 1


def test_the_example():
    done = run("python3", "/app/due.py", "/app/jobs.tab", "2025-06-15 06:30")
    assert (done.exit_code, done.out, done.errors) == (1, "send-invoices\n", "line 7: invalid\n")
