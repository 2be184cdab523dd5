"""What a verifier stands on, and the agent may have changed: the fixed list, as patterns over paths.

Programs that tests are run with, not those that a task may be about: an agent that repairs ``nginx`` or builds ``git``
is judged with its own. A task about one of these (a shell, Python itself) says ``tools="agent"`` to ``verify``.
"""

from __future__ import annotations

import re
from posixpath import basename, dirname

# Shells, coreutils, what scripts are made of, what tests are fetched with, and what shows processes.
_NAMES = """sh bash dash env busybox ldconfig ldconfig.real [ test true false yes cat head tail tac wc sort uniq cut
paste join comm tr fold fmt nl od split expand seq factor expr echo printf ls dir cp mv rm rmdir mkdir mkfifo mknod
ln link unlink touch chmod chown chgrp stat readlink realpath basename dirname pwd mktemp install dd df du
sync truncate date sleep timeout id whoami groups who users logname hostname uname nproc arch tty stty tee
nice nohup stdbuf kill chroot base64 base32 basenc cksum md5sum sha1sum sha224sum sha256sum sha384sum
sha512sum b2sum sum shuf numfmt printenv pathchk tsort ptx pr csplit shred grep egrep fgrep sed awk mawk gawk
original-awk find xargs diff cmp which getent su runuser setpriv ps pgrep pkill pidof ss netstat python pytest
py.test pip pip3 uv uvx curl wget tar gzip apt apt-get dpkg"""

TOOLS = frozenset(_NAMES.split())
"""Names of programs; those of Python itself (``python3``, ``python3.11``) are matched by a pattern."""

BIN_FOLDERS = ("/usr/local/sbin", "/usr/local/bin", "/usr/sbin", "/usr/bin", "/sbin", "/bin", "/root/.local/bin")
"""Where programs are looked for."""

LIBRARY_FOLDERS = ("/lib", "/lib32", "/lib64", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/local/lib")
"""Where the loader looks, and below them folders of one processor's libraries."""

FOLDERS = frozenset(
    (
        "/usr",
        "/usr/local",
        "/etc",
        "/etc/alternatives",
        "/etc/ld.so.conf.d",
        "/root",
        "/root/.local",
        *BIN_FOLDERS,
        *LIBRARY_FOLDERS,
    )
)
"""Folders above all of these."""

_PYTHON = re.compile(r"python3?(\.\d+)?")
_LIBRARIES = re.compile(
    r"(ld-linux[\w.-]*|ld-\d[\d.]*|ld-musl[\w.-]*|ld|"
    r"lib(c|m|dl|rt|pthread|util|resolv|crypt|nss_\w+|gcc_s|stdc\+\+|tinfo|ncursesw?|readline|selinux|pcre2-8|pcre|acl|attr|cap|"
    r"z|expat|ffi|ssl|crypto|bz2|lzma|sqlite3|uuid|proc2?|procps|gmp|sigsegv|mpfr|python3[\w.]*|musl[\w-]*)(-\d[\d.]*)?)"
    r"\.so([.\d]*)"
)
_HOME_BIN = re.compile(r"/home/[^/]+/\.local/bin")
_CONFIG = re.compile(r"/etc/(ld\.so\.(preload|conf|cache)|ld\.so\.conf\.d/.*|nsswitch\.conf|ld-musl-[\w.-]*\.path)")
_ROOT_CONFIG = re.compile(
    r"/(conftest\.py|\.?pytest\.(ini|toml)|pyproject\.toml|tox\.ini|setup\.(cfg|py)|__init__\.py|tests\.py)"
)
_STANDARD = re.compile(
    r"((?:/usr|/usr/local)?/lib(?:64)?/python3[^/]*)(?:/(?!site-packages(?:/|$)|dist-packages(?:/|$)).*)?"
)
_ZIP = re.compile(r"(/usr|/usr/local)?/lib(64)?/python3\d*\.zip")
_SITE = re.compile(r"(.*/(?:site|dist)-packages)/([^/]+)(?:/(.*))?")
_RUNNER = re.compile(
    r"_?pytest|py|pluggy|iniconfig|packaging|exceptiongroup|tomli|pygments|pytest[-_].*|ctrf.*", re.IGNORECASE
)
_VENV_CONFIG = re.compile(r"(/usr|/usr/local)?(/bin)?/pyvenv\.cfg")
_SITE_FOLDER = re.compile(
    r"(?:/usr|/usr/local|/root/\.local|/home/[^/]+/\.local)?/lib/python3[^/]*(/(site|dist)-packages)?"
)
_OF_PROCESSOR = re.compile(r"(/usr)?/lib/[^/]+-linux-[^/]+")
_SITE_HOOK = re.compile(r"(site|user)customize([./].*)?")


def is_folder(path: str) -> bool:
    """Return whether a path must be what it was, a folder or a link; what a folder holds is looked at by itself."""
    return path in FOLDERS or any(kind.fullmatch(path) for kind in (_SITE_FOLDER, _OF_PROCESSOR))


def is_tool(path: str) -> bool:
    """Return whether a path is that of a program on the list, or of the link that chooses between several."""
    folder, name = dirname(path), basename(path)
    in_place = folder in BIN_FOLDERS or folder == "/etc/alternatives" or _HOME_BIN.fullmatch(folder) is not None
    return in_place and (name in TOOLS or _PYTHON.fullmatch(name) is not None)


def is_library(path: str) -> bool:
    """Return whether a path is that of the loader, or of a library that the programs on the list are loaded with."""
    if not any(path.startswith(folder + "/") for folder in LIBRARY_FOLDERS):
        return False
    return _LIBRARIES.fullmatch(basename(path)) is not None


def is_setting(path: str) -> bool:
    """Return whether a file steers the loader, Python's start or pytest's, wherever tests run."""
    return any(kind.fullmatch(path) for kind in (_CONFIG, _ROOT_CONFIG, _ZIP, _VENV_CONFIG)) or is_site_hook(path)


def is_site_hook(path: str) -> bool:
    """Return whether Python would run a file at its start because of its name."""
    if "/python3" not in path and "-packages/" not in path:
        return False
    tail = path.rsplit("-packages/", 1)[-1] if "-packages/" in path else re.sub(r".*/python3[^/]*/", "", path)
    return _SITE_HOOK.fullmatch(tail) is not None


def standard_library(path: str) -> str:
    """Return the folder of the standard library that a path is in or is; empty where there is none."""
    found = _STANDARD.fullmatch(path)
    return found.group(1) if found else ""


def is_start_file(path: str) -> bool:
    """Return whether a file of a folder of packages may hold code to run at the start: of Python, or of pytest."""
    found = _SITE.fullmatch(path)
    if not found:
        return False
    if found.group(3) is None:
        return path.endswith(".pth")
    return found.group(2).endswith(("-info", ".egg")) and found.group(3).endswith("entry_points.txt")


def runs_code(path: str, content: bytes) -> bool:
    """Return whether a start file does hold such code."""
    if path.endswith(".pth"):
        return re.search(rb"(?m)^\s*import[ \t]", content) is not None
    return b"pytest11" in content


def runner_package(path: str) -> tuple[str, str]:
    """Return the path of the package of pytest's that a path belongs to, and its name; both empty where none is."""
    found = _SITE.fullmatch(path)
    if not found:
        return "", ""
    name = package_name(found.group(2))
    return (f"{found.group(1)}/{found.group(2)}", name) if _RUNNER.fullmatch(name) else ("", "")


def package_name(entry: str) -> str:
    """Return the name of the package that an entry of a folder of packages stands for, without its version."""
    return re.sub(r"(-[\d].*)?(\.(dist|egg)-info|\.py|\.egg|\.so)?$", "", entry).lower()


def may_shadow_runner(path: str) -> bool:
    """Return whether a path would stand in for a package of pytest's, if its folder were the working directory."""
    return package_name(basename(path)) in {"pytest", "_pytest", "pluggy", "iniconfig"}
