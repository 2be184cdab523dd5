"""Checks of the script, on folders of their own."""

import contextlib
import os
import tarfile
import tempfile

from sample_helpers import give, run

SCRIPT = "/app/keep-backups.sh"


@contextlib.contextmanager
def folders(*archives):
    """Give a source with some files, and a target with empty files of these names."""
    with tempfile.TemporaryDirectory(prefix="a folder ") as folder:
        source = os.path.join(folder, "source")
        target = os.path.join(folder, "target")
        os.makedirs(os.path.join(source, "deep er"))
        for name in ("notes.txt", ".hidden", "deep er/file"):
            with open(os.path.join(source, name), "w", encoding="utf-8") as file:
                file.write(f"content of {name}\n")
        if archives:
            os.makedirs(target)
        for name in archives:
            open(os.path.join(target, name), "w", encoding="utf-8").close()
        give(folder)
        yield source, target


def keep(source, target, count, cwd=None):
    return run("bash", SCRIPT, source, target, str(count), cwd=cwd)


def test_the_archive_has_the_contents():
    with folders() as (source, target):
        done = keep(source, target, 3)
        assert (done.exit_code, done.out) == (0, f"{target}/backup-001.tar.gz\n"), done.errors
        with tarfile.open(f"{target}/backup-001.tar.gz") as archive:
            files = {member.name.removeprefix("./") for member in archive if member.isfile()}
            assert files == {"notes.txt", ".hidden", "deep er/file"}
            assert archive.extractfile("./deep er/file").read() == b"content of deep er/file\n"


def test_relative_paths():
    with folders() as (source, target):
        done = keep("source", "target", 3, cwd=os.path.dirname(source))
        assert (done.exit_code, done.out) == (0, "target/backup-001.tar.gz\n"), done.errors
        with tarfile.open(f"{target}/backup-001.tar.gz") as archive:
            assert "./notes.txt" in archive.getnames()


def test_numbers_go_on():
    numbers = "007 008", "008 009", "009 010", "099 100", "999 1000", "1000 1001"
    for last, following in map(str.split, numbers):
        with folders(f"backup-{last}.tar.gz") as (source, target):
            assert keep(source, target, 5).out == f"{target}/backup-{following}.tar.gz\n"


def test_the_lowest_numbers_are_removed():
    names = ["backup-998.tar.gz", "backup-999.tar.gz", "backup-1000.tar.gz", "backup-1001.tar.gz"]
    with folders(*names) as (source, target):
        assert keep(source, target, 3).exit_code == 0
        assert sorted(os.listdir(target)) == ["backup-1000.tar.gz", "backup-1001.tar.gz", "backup-1002.tar.gz"]
    with folders(*(f"backup-{number:03}.tar.gz" for number in range(1, 13))) as (source, target):
        assert keep(source, target, 10).exit_code == 0
        assert sorted(os.listdir(target)) == [f"backup-{number:03}.tar.gz" for number in range(4, 14)]


def test_other_files_are_left_alone():
    others = ["README 9999", "backup-050.tar.gz.part", "zeta.txt", "backup-x.tar.gz"]
    with folders(*others, "backup-001.tar.gz") as (source, target):
        assert keep(source, target, 1).out == f"{target}/backup-002.tar.gz\n"
        assert sorted(os.listdir(target)) == sorted([*others, "backup-002.tar.gz"])


def test_bad_arguments_change_nothing():
    with folders("backup-001.tar.gz", "backup-002.tar.gz") as (source, target):
        wrong = [(source + "-not", 1), (source + "/notes.txt", 1), (source, 0), (source, "x"), (source, "")]
        for bad_source, count in wrong:
            done = keep(bad_source, target, count)
            assert (done.exit_code, done.out) == (2, ""), (bad_source, count)
            assert done.errors.strip(), (bad_source, count)
        assert sorted(os.listdir(target)) == ["backup-001.tar.gz", "backup-002.tar.gz"]
    with folders() as (source, target):
        assert keep(source + "-not", target, 1).exit_code == 2
        assert not os.path.lexists(target)
