"""Lock open files between processes; a lock ends with its process: flock(2), or LockFile on Windows.

Devices, recordings, shared memory of `rig.realtime` and scratch directories use it. It must not wait for a lock, nor
write to or remove the file.
"""

import os
import sys

if sys.platform == "win32":
    import msvcrt

    # On Windows other processes cannot read a locked byte: lock one far behind all data, within 31 bits of `locking`.
    _PLACE = 0x7FFF_0000

    def _call(descriptor: int, mode: int) -> None:
        before = os.lseek(descriptor, 0, os.SEEK_CUR)
        try:
            os.lseek(descriptor, _PLACE, os.SEEK_SET)
            msvcrt.locking(descriptor, mode, 1)
        finally:
            os.lseek(descriptor, before, os.SEEK_SET)

    def lock(descriptor: int) -> bool:
        """Lock an open file; return False if another process has locked it; raise `OSError` without lock support."""
        try:
            _call(descriptor, msvcrt.LK_NBLCK)
        except PermissionError:
            return False
        return True

    def unlock(descriptor: int) -> None:
        """Release the lock of an open file."""
        _call(descriptor, msvcrt.LK_UNLCK)

else:
    import fcntl

    def lock(descriptor: int) -> bool:
        """Lock an open file; return False if another process has locked it; raise `OSError` without lock support."""
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        return True

    def unlock(descriptor: int) -> None:
        """Release the lock of an open file."""
        fcntl.flock(descriptor, fcntl.LOCK_UN)


def is_locked(path: str | os.PathLike[str]) -> bool:
    """Return True if a process has locked the file; on systems other than Linux, test by a short lock."""
    try:
        # Read and not tried: to take the lock even for a moment would make another process's attempt fail.
        if sys.platform == "linux":
            there = os.stat(path)
            name = f"{os.major(there.st_dev):02x}:{os.minor(there.st_dev):02x}:{there.st_ino}"
            with open("/proc/locks", encoding="ascii") as lines:
                return any(name in line.split() for line in lines if " FLOCK " in line)
        else:
            with open(path, "rb") as file:
                return not lock(file.fileno())
    except OSError:
        return False
