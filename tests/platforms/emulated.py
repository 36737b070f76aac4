"""Emulate Windows or macOS on Linux, as far as possible, for our packages alone.

The packages see `sys.platform` of that system, without the modules and names that it lacks (typeshed's conditions on
`sys.platform`). This shows that they need nothing else; not that the rest behaves as on Linux.
"""

import builtins
import ctypes
import fcntl
import os
import sys
from collections.abc import Callable
from types import ModuleType
from typing import Any

PACKAGES = ("rig", "sim_backend", "firmware_protocol")
LINUX_ALONE = {
    "os": "memfd_create MFD_CLOEXEC MFD_ALLOW_SEALING pipe2 posix_fallocate sched_setaffinity sched_getaffinity "
    "sched_setscheduler sched_getscheduler sched_param sched_getparam SCHED_FIFO SCHED_RESET_ON_FORK eventfd "
    "O_DIRECT",
    "errno": "EREMOTEIO",
    "fcntl": "F_ADD_SEALS F_GET_SEALS F_SEAL_SHRINK F_SEAL_GROW",
    "time": "CLOCK_BOOTTIME",
    "resource": "RLIMIT_RTPRIO",
}
POSIX_ALONE = {
    "os": "getuid geteuid getgid getegid getgroups getpgrp getpgid setsid setpgid fork forkpty openpty ttyname "
    "tcgetpgrp mkfifo pread pwrite fchmod fchown chown killpg wait wait4 waitpid WNOHANG uname nice getloadavg "
    "sysconf statvfs O_CLOEXEC O_NONBLOCK O_NOCTTY O_DIRECTORY O_SYNC confstr set_blocking",
    "signal": "SIGHUP SIGKILL SIGTSTP SIGTTOU SIGTTIN SIGWINCH SIGUSR1 SIGUSR2 SIGQUIT SIGALRM SIGCHLD SIGPIPE SIGCONT "
    "SIGSTOP pthread_sigmask pthread_kill SIG_BLOCK SIG_UNBLOCK SIG_SETMASK setitimer alarm pause sigwait",
    "select": "poll epoll POLLIN POLLOUT POLLERR POLLHUP",
    "socket": "AF_UNIX socketpair",
    "time": "clock_gettime clock_getres CLOCK_MONOTONIC CLOCK_REALTIME",
    "mmap": "MAP_SHARED MAP_PRIVATE MAP_ANONYMOUS PROT_READ PROT_WRITE",
}
POSIX_MODULES = frozenset(
    {"fcntl", "grp", "pwd", "termios", "resource", "tty", "pty", "posix", "syslog", "readline"}
)
FAR_BEHIND_ALL_DATA, LONG_MAX = 1 << 30, (1 << 31) - 1


def _refuse(*_: object, **__: object) -> Any:
    raise TypeError("LoadLibrary() argument 1 must be str, not None")


def _locking(descriptor: int, mode: int, count: int) -> None:
    """Emulate `msvcrt.locking`: lock bytes from the file's 32-bit position against reading by others."""
    at = os.lseek(descriptor, 0, os.SEEK_CUR)
    assert FAR_BEHIND_ALL_DATA <= at <= LONG_MAX - count
    if mode == MSVCRT["LK_UNLCK"]:
        fcntl.flock(descriptor, fcntl.LOCK_UN)
        return
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError as error:
        raise PermissionError(13, "Permission denied") from error


MSVCRT: dict[str, Any] = {"LK_UNLCK": 0, "LK_LOCK": 1, "LK_NBLCK": 2, "locking": _locking}


class Seen(ModuleType):
    """A module as another system has it: the true one with `added` and without `missing` names."""

    def __init__(self, true: ModuleType, missing: frozenset[str], added: dict[str, Any]) -> None:
        super().__init__(true.__name__)
        self.__dict__.update(added)
        self._true, self._missing = true, missing

    def __getattr__(self, name: str) -> Any:
        if name in self._missing:
            raise AttributeError(f"module '{self.__name__}' has no attribute '{name}' on this system")
        return getattr(self._true, name)


class _Ctypes(Seen):
    """The module ctypes of Windows, where a library needs a name."""

    def __getattr__(self, name: str) -> Any:
        found = super().__getattr__(name)
        if name != "CDLL":
            return found
        return lambda path, *a, **k: _refuse() if path is None else found(path, *a, **k)


def emulate(platform: str) -> None:
    """Let our packages, which must not be imported yet, see this system from now on."""
    assert not any(name.partition(".")[0] in PACKAGES for name in sys.modules)
    builtins.__import__ = import_of(platform, builtins.__import__)
    if platform == "win32":
        keep_open_files()


def keep_open_files() -> None:
    """Refuse, as Windows does, to remove or rename a file that is open or mapped."""
    for name in ("unlink", "remove", "rename", "replace"):
        setattr(os, name, unless_open(getattr(os, name)))


def unless_open(call: Callable[..., None]) -> Callable[..., None]:
    def checked(path: Any, *more: Any, **options: Any) -> None:
        links = [os.path.realpath(f"/proc/self/fd/{name}") for name in os.listdir("/proc/self/fd")]
        with open("/proc/self/maps") as maps:
            mapped = [line.split(maxsplit=5)[-1].strip() for line in maps]
        for one in map(os.path.realpath, (path, *more[:1])):
            if os.path.isfile(one) and one in (*links, *mapped):
                raise PermissionError(13, "The process cannot access the file: it is being used", path)
        call(path, *more, **options)

    return checked


def import_of(platform: str, true_import: Callable[..., Any]) -> Callable[..., Any]:
    """Return an ``__import__`` that behaves as on that system for our packages."""
    seen = _modules(platform)
    absent = POSIX_MODULES if platform == "win32" else frozenset({"msvcrt", "winreg"})

    def imported(
        name: str,
        globals: dict[str, Any] | None = None,
        locals: dict[str, Any] | None = None,
        fromlist: tuple[str, ...] = (),
        level: int = 0,
    ) -> Any:
        ours = globals is not None and str(globals.get("__name__", "")).partition(".")[0] in PACKAGES
        if ours and level == 0:
            if name in absent:
                raise ModuleNotFoundError(f"No module named '{name}' on {platform}", name=name)
            if name in seen:
                return seen[name]
        return true_import(name, globals, locals, fromlist, level)

    return imported


def _modules(platform: str) -> dict[str, ModuleType]:
    names = {"os", "signal", "select", "socket", "time", "errno", "mmap", "fcntl", "resource"}
    missing = [LINUX_ALONE, *([POSIX_ALONE] if platform == "win32" else [])]
    found: dict[str, ModuleType] = {}
    for name in sorted(names):
        gone = frozenset(word for table in missing for word in table.get(name, "").split())
        added: dict[str, Any] = {}
        if platform == "win32":
            added = {"os": {"O_BINARY": 0x8000_0000}, "signal": {"SIGBREAK": 21}}.get(name, {})
        found[name] = Seen(__import__(name), gone, added)
    found["sys"] = Seen(sys, frozenset(), {"platform": platform})
    if platform == "win32":
        found["msvcrt"] = Seen(ModuleType("msvcrt"), frozenset(), MSVCRT)
        found["ctypes"] = _Ctypes(ctypes, frozenset(), {})
        found["os"].__dict__["open"] = _opened
    return found


def _opened(path: Any, flags: int, mode: int = 0o777) -> int:
    return os.open(path, flags & ~0x8000_0000, mode)
