"""The root folder that a machine starts with, before a task adds to it."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

from gem_terminal.backends.local import launch

_FOLDERS = {
    **dict.fromkeys(("app", "dev", "etc", "home", "logs", "media", "mnt", "opt", "proc", "root", "run", "srv"), 0o755),
    **dict.fromkeys(
        ("usr", "usr/local", "var", "var/cache", "var/lib", "var/log", "var/spool", "var/spool/cron"), 0o755
    ),
    **{f"usr/local/{name}": 0o755 for name in ("bin", "etc", "include", "lib", "sbin", "share", "src")},
    **dict.fromkeys(("tmp", "var/tmp", "run/lock"), 0o1777),
    "root": 0o700,
}
_FILES = {
    "passwd": "root:x:0:0:root:/root:/bin/bash\nnobody:x:65534:65534:nobody:/nonexistent:/usr/sbin/nologin\n",
    "group": "root:x:0:\nnogroup:x:65534:\n",
    "shadow": "root:*:20000:0:99999:7:::\nnobody:*:20000:0:99999:7:::\n",
    "hosts": "127.0.0.1\tlocalhost\n::1\tlocalhost ip6-localhost ip6-loopback\n",
    "nsswitch.conf": "passwd: files\ngroup: files\nshadow: files\nhosts: files\nservices: files\nprotocols: files\n",
    "resolv.conf": "",
    "hostname": "terminal\n",
    "shells": "/bin/sh\n/bin/bash\n",
}
# What programs of the system need of its settings, and what says nothing of whoever uses it.
_COPIED = (
    *("debian_version", "inputrc", "ld.so.cache", "ld.so.conf", "ld.so.conf.d", "localtime"),
    *("login.defs", "lsb-release", "magic", "magic.mime", "mime.types", "nanorc", "os-release", "perl", "profile"),
    *("protocols", "rpc", "services", "terminfo", "timezone", "vim"),
)
_PROFILE = {".bashrc": "", ".profile": 'if [ "$BASH" ] && [ -f ~/.bashrc ]; then . ~/.bashrc; fi\n'}


def make(root: Path) -> None:
    """Make a root folder, for the sandbox's user.

    Raises:
        OSError: It cannot be made.
    """
    root.mkdir(mode=0o755)
    root.chmod(0o755)
    for name, mode in _FOLDERS.items():
        folder = root / name
        folder.mkdir(parents=True, exist_ok=True)
        folder.chmod(mode)
    for path, target in launch.links():
        os.symlink(target, f"{root}{path}")
    for path in launch.system():
        (root / path[1:]).mkdir(parents=True, exist_ok=True)
    os.symlink("/run", root / "var/run")
    for name, text in _FILES.items():
        (root / "etc" / name).write_text(text, "utf-8")
    (root / "etc/shadow").chmod(0o640)
    for name, text in _PROFILE.items():
        (root / "root" / name).write_text(text, "utf-8")
    _copy_settings(root / "etc")
    _copy_alternatives(root / "etc/alternatives")
    _python(root / "usr/local/bin")
    user = launch.uid()
    if user is not None:
        subprocess.run(["chown", "-hR", f"{user}:{user}", "--", str(root)], check=True, stdin=subprocess.DEVNULL)


def _copy_settings(etc: Path) -> None:
    for name in _COPIED:
        source, target = Path("/etc", name), etc / name
        try:
            if source.is_symlink():
                target.symlink_to(os.readlink(source))
            elif source.is_dir():
                shutil.copytree(source, target, symlinks=True)
            elif source.is_file():
                shutil.copyfile(source, target)
        except (OSError, shutil.Error):
            continue  # not for this user to read: then not for an agent either


def _copy_alternatives(folder: Path) -> None:
    """Copy the links that programs have as one of their names; there are many more, of their manuals."""
    folder.mkdir()
    try:
        links = [link for link in Path("/etc/alternatives").iterdir() if os.access(link, os.X_OK) and link.is_file()]
    except OSError:
        return  # this system has none
    for link in links:
        (folder / link.name).symlink_to(os.readlink(link))


def _python(folder: Path) -> None:
    """Give programs an interpreter under the names that an image of Python has."""
    for name in ("python", "python3"):
        if f"/usr/bin/{name}" != launch.python():
            (folder / name).symlink_to(launch.python())
