"""The calls to the Linux kernel that Python's ``os`` lacks in some version that we support."""

from __future__ import annotations

import ctypes
import os
import struct

CLONE_NEWNS = 0x00020000
MS_RDONLY, MS_NOSUID, MS_NODEV, MS_REMOUNT, MS_BIND, MS_REC, MS_PRIVATE = 1, 2, 4, 32, 0x1000, 0x4000, 0x40000
MNT_DETACH = 2
PR_SET_PDEATHSIG, PR_CAPBSET_DROP, PR_SET_CHILD_SUBREAPER, PR_SET_NO_NEW_PRIVS, PR_CAP_AMBIENT = 1, 24, 36, 38, 47

AUDIT_WRITE = 29
AGENT_CAPABILITIES = (0, 1, 3, 4, 5, 6, 7, 10, 18)
"""CHOWN, DAC_OVERRIDE, FOWNER, FSETID, KILL, SETGID, SETUID, NET_BIND_SERVICE, SYS_CHROOT: what root of a container
has, and what is harmless in a user namespace that holds one user, under a root of its own."""

JUDGE_CAPABILITIES = (*AGENT_CAPABILITIES, AUDIT_WRITE)
"""One more than the agent's: the kernel then refuses the agent's processes all that tracing needs."""

_CAPABILITY_VERSION_3 = 0x20080522
_AMBIENT_CLEAR_ALL = 4
_PR_SET_SECCOMP, _SECCOMP_MODE_FILTER = 22, 2
# The number by which seccomp knows a machine, and that of prlimit64 on it.
_PRLIMIT = {"x86_64": (0xC000003E, 302), "aarch64": (0xC00000B7, 261)}
_X32 = 0x40000000
_libc = ctypes.CDLL(None, use_errno=True)


def _checked(result: int, what: str) -> None:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{what}: {os.strerror(number)}")


def unshare(flags: int) -> None:
    """Move this process into new namespaces."""
    _checked(_libc.unshare(flags), "unshare")


def setns(descriptor: int, kind: int) -> None:
    """Move this process into the namespace of a file descriptor."""
    _checked(_libc.setns(descriptor, kind), "setns")


def mount(source: str, target: str, flags: int, kind: str = "", options: str = "") -> None:
    """Mount a file system, or bind a part of one."""
    texts = [text.encode() or None for text in (source, target, kind)]
    _checked(_libc.mount(*texts, ctypes.c_ulong(flags), options.encode() or None), f"mount {target}")


def unmount(target: str) -> None:
    """Take a file system out of the tree, at once; it ends with the last process that uses it."""
    _checked(_libc.umount2(target.encode(), MNT_DETACH), f"umount {target}")


def pivot_root() -> None:
    """Make the current folder, a mount of its own, the root, and let go of the old one."""
    _checked(_libc.pivot_root(b".", b"."), "pivot_root")
    unmount(".")
    os.chdir("/")


def prctl(option: int, *values: int) -> None:
    """Set something of this process."""
    words = [ctypes.c_ulong(value) for value in (*values, 0, 0, 0, 0)[:4]]
    _checked(_libc.prctl(option, *words), f"prctl {option}")


def guard_limits() -> None:
    """Forbid setting the limits of other processes for good: as one user, the agent could set the keeper's.

    Needs ``PR_SET_NO_NEW_PRIVS``. On machines of other kinds than the two usual ones, it does nothing.
    """
    known = _PRLIMIT.get(os.uname().machine)
    if known is None:
        return
    load, equal, at_least, end = 0x20, 0x15, 0x35, 0x06
    allow, no_permission, no_such_call = 0x7FFF0000, 0x00050000 | 1, 0x00050000 | 38
    steps = [
        (load, 0, 0, 4),  # the machine
        (equal, 0, 6, known[0]),
        (load, 0, 0, 0),  # the call
        (at_least, 4, 0, _X32),
        (equal, 0, 4, known[1]),
        (load, 0, 0, 16),  # its first argument: the process, 0 for itself
        (equal, 2, 0, 0),
        (end, 0, 0, no_permission),
        (end, 0, 0, no_such_call),
        (end, 0, 0, allow),
    ]
    code = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *step) for step in steps))
    program = ctypes.create_string_buffer(struct.pack("HxxxxxxQ", len(steps), ctypes.addressof(code)))
    prctl(_PR_SET_SECCOMP, _SECCOMP_MODE_FILTER, ctypes.addressof(program))


def keep_capabilities(kept: tuple[int, ...]) -> None:
    """Give up all other capabilities for good, whatever program comes next."""
    number = 0
    while True:
        try:
            if number not in kept:
                prctl(PR_CAPBSET_DROP, number)
        except OSError:
            break  # beyond the last that this kernel knows
        number += 1
    prctl(PR_CAP_AMBIENT, _AMBIENT_CLEAR_ALL)
    mask = sum(1 << number for number in kept)
    low, high = mask & 0xFFFFFFFF, mask >> 32
    header = (ctypes.c_uint32 * 2)(_CAPABILITY_VERSION_3, 0)
    sets = (ctypes.c_uint32 * 6)(low, low, 0, high, high, 0)
    _checked(_libc.capset(header, sets), "capset")
    prctl(PR_SET_NO_NEW_PRIVS, 1)
