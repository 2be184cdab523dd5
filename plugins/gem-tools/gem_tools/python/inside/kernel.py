"""The calls to the Linux kernel that Python's ``os`` lacks in some version that we support."""

from __future__ import annotations

import ctypes
import os
import struct

NEWUSER, NEWNS, NEWPID, NEWIPC, NEWNET = 0x10000000, 0x00020000, 0x20000000, 0x08000000, 0x40000000
MS_NOSUID, MS_NODEV, MS_BIND, MS_REC, MS_PRIVATE = 2, 4, 0x1000, 0x4000, 0x40000
MNT_DETACH = 2
PR_SET_PDEATHSIG, PR_SET_DUMPABLE, PR_SET_SECCOMP, PR_SET_CHILD_SUBREAPER, PR_SET_NO_NEW_PRIVS = 1, 4, 22, 36, 38
SECCOMP_MODE_FILTER = 2
_CAPABILITY_VERSION_3 = 0x20080522

_libc = ctypes.CDLL(None, use_errno=True)


def _checked(result: int, what: str) -> int:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{what}: {os.strerror(number)}")
    return result


_with_interpreter = ctypes.PyDLL(None, use_errno=True)


def fork() -> int:
    """Fork without what Python does in each child, which touches, hence copies, much of its memory.

    For a process of one thread that holds no lock: Python's own fork would only make it so. What draws random numbers
    must be seeded anew in the child.
    """
    return _checked(_with_interpreter.fork(), "fork")


def unshare(flags: int) -> None:
    """Move this process into new namespaces; for processes, its next child."""
    _checked(_libc.unshare(flags), "unshare")


def setns(descriptor: int, kind: int) -> None:
    """Move this process into the namespace of a file descriptor."""
    _checked(_libc.setns(descriptor, kind), "setns")


def mount(source: str, target: str, kind: str, flags: int, options: str = "") -> None:
    """Mount a file system."""
    texts = [text.encode() for text in (source, target, kind)]
    _checked(_libc.mount(*texts, ctypes.c_ulong(flags), options.encode() or None), f"mount {target}")


def unmount(target: str) -> None:
    """Take a file system out of the tree, at once; it ends with the last process that uses it."""
    _checked(_libc.umount2(target.encode(), MNT_DETACH), f"umount {target}")


def prctl(option: int, value: int, pointer: object = 0) -> None:
    """Set something of this process."""
    third = pointer if not isinstance(pointer, int) else ctypes.c_ulong(pointer)
    _checked(_libc.prctl(option, ctypes.c_ulong(value), third, ctypes.c_ulong(0), ctypes.c_ulong(0)), "prctl")


def end_on(*signals: int) -> None:
    """Let signals end this process and those that it forks, with their number as the exit code.

    The first process of a namespace ignores every signal that it does not handle, those of its own timers too. Python
    does not notice this handler, and says that there is none.
    """
    handler = ctypes.cast(_libc._exit, ctypes.c_void_p)
    for number in signals:
        _libc.signal(int(number), handler)


def syscall(number: int, *arguments: object) -> int:
    """Make a system call that the C library has no function for; -1 where it fails, with ``ctypes.get_errno()``."""
    words = [ctypes.c_long(each) if isinstance(each, int) else each for each in arguments]
    return int(_libc.syscall(ctypes.c_long(number), *words))


class _CapabilityHeader(ctypes.Structure):
    _fields_ = (("version", ctypes.c_uint32), ("pid", ctypes.c_int))


def drop_capabilities() -> None:
    """Give up every capability, for good."""
    header = _CapabilityHeader(_CAPABILITY_VERSION_3, 0)
    nothing = (ctypes.c_uint32 * 6)()
    _checked(_libc.capset(ctypes.byref(header), nothing), "capset")


class _Program(ctypes.Structure):
    _fields_ = (("length", ctypes.c_ushort), ("instructions", ctypes.c_void_p))


class FilterProgram:
    """A program of classic BPF.

    Args:
        lines: Its instructions: code, the two jumps, and the constant.
    """

    def __init__(self, lines: list[tuple[int, int, int, int]]) -> None:
        packed = b"".join(struct.pack("HBBI", *line) for line in lines)
        self._instructions = ctypes.create_string_buffer(packed, len(packed))
        self._whole = _Program(len(lines), ctypes.addressof(self._instructions))
        self._pointer = ctypes.byref(self._whole)

    def set(self) -> None:
        """Let it decide on each system call of this process and its children, for good."""
        prctl(PR_SET_SECCOMP, SECCOMP_MODE_FILTER, self._pointer)
