"""A Debian kernel: download the package, unpack it, and sort its modules in the order in which they load."""

import re
import subprocess
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from tests.guest.absent import GuestAbsentError

META_PACKAGE = "linux-image-amd64"
FETCH_TIMEOUT_S = 300.0


@dataclass(frozen=True, slots=True)
class Kernel:
    release: str
    image: Path
    modules: Path


def unpacked_kernel(cache: Path) -> Kernel:
    """Return the kernel of this Debian, unpacked in `cache`; the first call fetches 70 MB."""
    package = _newest_image()
    root = cache / package
    if not (root / "whole").exists():
        try:
            root.mkdir(parents=True, exist_ok=True)
            _run("apt-get", "download", "-qq", package, directory=root)
            (archive,) = root.glob("*.deb")
            _run("dpkg", "-x", archive.name, ".", directory=root)
            archive.unlink()
            (root / "whole").touch()  # an unpacking that was cut short starts anew
        except (OSError, ValueError) as error:
            raise GuestAbsentError(f"the kernel {package} does not unpack in {root}: {error}") from error
    release = package.removeprefix("linux-image-")
    return Kernel(release, root / "boot" / f"vmlinuz-{release}", root / "lib" / "modules" / release)


def _newest_image() -> str:
    text = _run("apt-cache", "depends", META_PACKAGE)
    found = re.search(r"Depends: (linux-image-\S+)", text)
    if found is None:
        raise GuestAbsentError(f"apt knows no {META_PACKAGE}: run apt-get update, on Debian for amd64")
    return found.group(1)


def _run(*command: str, directory: Path | None = None) -> str:
    try:
        return subprocess.run(
            command, cwd=directory, check=True, capture_output=True, text=True, timeout=FETCH_TIMEOUT_S
        ).stdout
    except subprocess.CalledProcessError as error:
        lines = error.stderr.strip().splitlines()
        raise GuestAbsentError(f"{' '.join(command)}: {lines[-1] if lines else error}") from error
    except (OSError, subprocess.TimeoutExpired) as error:
        raise GuestAbsentError(f"{' '.join(command)}: {error}") from error


def with_dependencies(kernel: Kernel, names: Iterable[str]) -> list[Path]:
    """Return the files of modules and of their dependencies in the order of insertion, without built-in ones."""
    files = {_plain(path.name.partition(".ko")[0]): path for path in kernel.modules.rglob("*.ko")}
    built_in = _built_in(kernel)
    ordered: list[Path] = []

    def add(name: str) -> None:
        if name in built_in:
            return
        if name not in files:
            raise GuestAbsentError(f"the kernel {kernel.release} has no module {name}")
        if files[name] not in ordered:
            for needed in _depends(files[name]):
                add(needed)
            ordered.append(files[name])

    for name in names:
        add(_plain(name))
    return ordered


def _plain(name: str) -> str:
    return name.replace("-", "_")


def _built_in(kernel: Kernel) -> set[str]:
    lines = (kernel.modules / "modules.builtin").read_text().splitlines()
    return {_plain(Path(line).name.partition(".ko")[0]) for line in lines}


def _depends(module: Path) -> Iterator[str]:
    """Yield the names in ``depends=`` of a module's ``.modinfo`` section, which is zero-terminated text."""
    for text in re.findall(rb"\0depends=([^\0]*)\0", module.read_bytes()):
        yield from (_plain(name) for name in text.decode().split(",") if name)
