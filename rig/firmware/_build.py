"""Build the firmware of a board for one rig, from the C sources and a generated C file that describes the rig.

Builds are reproducible: the files contain no time, no path and no name of a computer. `rig firmware build` calls it. It
must not flash a board.
"""

import hashlib
import json
import math
import os
import shutil
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from firmware_protocol.dictionary import SettingValue
from rig.config import Controller, amplifiers
from rig.core.errors import ConfigError, RecordingError, ToolchainError
from rig.core.model import RigModel
from rig.core.present import Row, plain
from rig.core.scratch import scratch
from rig.firmware._board_config import BoardConfig, configure
from rig.firmware._boards import FIRMWARE, Board, load, settings_of
from rig.firmware._elf import Segment, flat, read_segments, seal
from rig.firmware._scales import check_scales
from rig.firmware._toolchain import Compiler, find_compiler
from rig.firmware._uf2 import write_uf2
from rig.firmware.tick_budget import INTEGERS, TickBudget, tick_budget

WARNINGS = ("-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wpedantic", "-Wdate-time", "-Werror")
# Floats must round as on the host: no contraction, no reassociation.
CODE = (
    "-mthumb",
    "-g",
    "-gno-record-gcc-switches",
    "-ffp-contract=off",
    "-ffunction-sections",
    "-fdata-sections",
    "-fno-math-errno",
    "-fno-common",
)
LINK = (
    "-nostartfiles",
    "--specs=nosys.specs",
    "-Wl,--gc-sections",
    "-Wl,--fatal-warnings",
    # No code refers to the record that identifies the image: without this option the linker would discard it.
    "-Wl,-u,image_record",
)
SHARED = ("core", "law")  # directories whose C files belong to every image
DEVICE = "device"  # the program that is the firmware
# The program that tests the device's port, in place of the core: every board has it.
PORT_CHECK = "port_check"
COARSE_STEP = 2.0  # quanta of the rig's commands in one step of the output, from which on a build warns
PORT_CHECK_SOURCES = ("port_check/port_check.c", "core/frame.c", "core/protocol.c")

Progress = Callable[[str, float], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildRequest:
    """Parameters of a firmware build.

    Attributes
    ----------
    model
        The rig; an image is valid for one rig only.
    board
        Name of the board (`rig.firmware._boards.names`).
    output
        Directory for the files.
    settings
        Pins and scales that replace those in the rig's description (`RigModel.board`) and the board's defaults.
    application
        Program to build: one of the board's programs (``device`` is the firmware), or the test program `PORT_CHECK`.
    controller
        Rates and estimator of the rig's experiment; if the law runs on the device, its time per tick is checked.
    """

    model: RigModel
    board: str
    output: Path
    controller: Controller | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    application: str = DEVICE


@dataclass(frozen=True, slots=True, kw_only=True)
class BuildResult:
    """Result of a build.

    Attributes
    ----------
    elf, bin, uf2, facts
        Paths of the image for a debugger, as plain bytes, for the boot ROM's drive (None if the board accepts no UF2),
        and of this result as JSON.
    firmware
        Version text that the device will report.
    dictionary_hash
        Hash of the device's dictionary (description of itself), as in its messages.
    quantum_a, set_point_step_a
        Resolution of the rig's commands, and of the board's output at the amplifier (A); None without such an output.
    flash_bytes, ram_bytes
        Flash and RAM that the program uses, including the linker script's reserve for the stack.
    flash_room, ram_room
        Size of the board's flash and RAM (bytes).
    ticks
        For a law on the device in integers and in float32: text with the highest rate that the processor can run.
    warnings
        Requirements of the rig's experiment that this image does not fulfil, each with its remedy.
    """

    board: str
    rig: str
    application: str
    firmware: str
    protocol: str
    dictionary_hash: str
    compiler: str
    settings: dict[str, int | float | str]
    quantum_a: float
    set_point_step_a: float | None
    elf: Path
    bin: Path
    uf2: Path | None
    facts: Path
    flash_bytes: int
    flash_room: int
    ram_bytes: int
    ram_room: int
    sha256: str
    ticks: Mapping[str, str] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    def rows(self) -> list[Row]:
        """Return the result of the build as rows (label, value, unit, note) to print."""
        return [
            Row("firmware", self.firmware),
            Row("rig", self.rig),
            Row("protocol", self.protocol, note=f"dictionary {self.dictionary_hash}"),
            Row("flash", self.flash_bytes, "bytes", _percent_of(self.flash_bytes, self.flash_room)),
            Row("memory", self.ram_bytes, "bytes", _percent_of(self.ram_bytes, self.ram_room)),
            Row("compiler", self.compiler),
            *self._set_point_rows(),
            *(Row(f"law, {name}", text) for name, text in self.ticks.items()),
            *(Row(name, value) for name, value in self.settings.items()),
        ]

    def _set_point_rows(self) -> list[Row]:
        if self.set_point_step_a is None:
            return []
        quantum = f"the rig's simulation has rig.amplifier.current_quantum_a = {self.quantum_a:g} A"
        note = quantum if self.set_point_step_a > self.quantum_a else ""
        return [Row("set-point step", f"{self.set_point_step_a:.3g}", "A", note)]


def _percent_of(used: int, room: int) -> str:
    return f"{100 * used / room:.3g} % of {room // 1024} KiB"


def _warnings(request: BuildRequest, budget: TickBudget | None, step_a: float | None) -> tuple[str, ...]:
    """Return warnings if the law is slower than the experiment's tick rate, or the output coarser than a command."""
    warnings, controller, quantum_a = [], request.controller, request.model.amplifier.current_quantum_a
    if budget is not None and controller is not None and controller.loop == "device":
        fastest = budget.rate_maximum(controller.estimator)
        if controller.position_rate > fastest:
            warnings.append(
                f"the law of {request.model.name} is too slow for {controller.position_rate} Hz: "
                f"{budget.text(controller.estimator)}; choose a rate of at most {math.floor(fastest)} Hz, or the "
                f"estimator {INTEGERS} (at most {math.floor(budget.rate_maximum(INTEGERS))} Hz)"
            )
    if step_a is not None and step_a > COARSE_STEP * quantum_a:
        warnings.append(
            f"one step of the set-point is {step_a:.3g} A, {step_a / quantum_a:.3g} times the rig's "
            f"current_quantum_a = {quantum_a:g} A: simulation, theory and maps would assume a finer resolution; set "
            f"rig.amplifier.current_quantum_a = {step_a:.3g}, or lower full_scale there and in the amplifier"
        )
    return tuple(warnings)


def build(request: BuildRequest, on_progress: Progress = lambda _step, _share: None) -> BuildResult:
    """Build a firmware image and write its files.

    Parameters
    ----------
    request
        Rig, board, program and output directory.
    on_progress
        Called with the name of the current step and the completed share of that step, 0 … 1.

    Raises
    ------
    ConfigError
        The board, one of its settings or the program is unknown, or a scale (A at full output) does not fit the rig.
    ToolchainError
        The compiler is missing or rejects the sources, or the image is too large.
    RecordingError
        The files cannot be written.
    """
    board = load(request.board)
    # The port check runs on the files of the device's port, which it tests.
    port_program = DEVICE if request.application == PORT_CHECK else request.application
    if port_program not in board.applications:
        raise ConfigError(
            f"board {board.name} has no program {request.application!r}",
            remedy=f"choose one of its programs: {', '.join(board.applications)}",
        )
    _make_directory(request.output)
    compiler = find_compiler()
    profile = amplifiers.load(request.model.amplifier.profile)
    of_amplifier = {name: value for name, value in profile.settings.items() if name in board.settings}
    settings = settings_of(board, {**of_amplifier, **dict(request.model.board), **request.settings})
    step_a = check_scales(board, request.model, settings)
    sources = (*shared_sources(request.application), *board.sources(port_program))
    config = configure(board, request.model, settings, package=package_version(), sources=sources_hash(board))
    with scratch("firmware") as place:
        content = _compile(compiler, board, sources, config, place, on_progress)
    segments = read_segments(content, "the new program")
    return _write_files(request, board, compiler, config, content, segments, settings, step_a)


def shared_sources(application: str = DEVICE) -> tuple[Path, ...]:
    """Return the C files of a program (`application`) that are the same for all boards."""
    if application == PORT_CHECK:
        return tuple(FIRMWARE / name for name in PORT_CHECK_SOURCES)
    return tuple(path for part in SHARED for path in sorted((FIRMWARE / part).glob("*.c")))


def sources_hash(board: Board) -> str:
    """Return the hash (12 hexadecimal digits) of all sources for a board, without the files generated for a rig."""
    digest = hashlib.sha256()
    directories = [*(FIRMWARE / part for part in SHARED), board.directory]
    files = (path for directory in directories for path in directory.iterdir() if path.is_file())
    for name, path in sorted((_path_in_tree(path, board).as_posix(), path) for path in files):
        digest.update(name.encode() + b"\0" + hashlib.sha256(path.read_bytes()).digest())
    return digest.hexdigest()[:12]


def _path_in_tree(path: Path, board: Board) -> Path:
    if path.is_relative_to(board.directory):
        return Path("board") / path.relative_to(board.directory)
    return Path("firmware") / path.relative_to(FIRMWARE)


def package_version() -> str:
    """Return the version of the installed package haptic-rig, "0" if it is not installed."""
    try:
        return version("haptic-rig")
    except PackageNotFoundError:
        return "0"  # a tree that was never installed


def _compile(
    compiler: Compiler,
    board: Board,
    sources: tuple[Path, ...],
    config: BoardConfig,
    scratch: Path,
    on_progress: Progress,
) -> bytes:
    """Compile and link in the scratch directory; return the bytes of the ELF file, which contains no absolute path."""
    for name, directory in (("firmware", FIRMWARE), ("board", board.directory)):
        if os.name == "posix":
            (scratch / name).symlink_to(directory, target_is_directory=True)
        else:
            shutil.copytree(directory, scratch / name)
    (scratch / "board_config.h").write_text(config.header, encoding="utf-8")
    (scratch / "board_config.c").write_text(config.source, encoding="utf-8")
    names = [_path_in_tree(path, board).as_posix() for path in sources] + ["board_config.c"]
    include = ["-I.", *(f"-Ifirmware/{part}" for part in SHARED), "-Iboard"]
    # The debugger's notes contain paths too, which would make the bytes differ from machine to machine.
    without_path = f"-ffile-prefix-map={os.path.realpath(scratch)}=."
    common = [*WARNINGS, *CODE, without_path, *board.processor, *board.compile, *include]
    objects = [f"{number}.o" for number in range(len(names))]

    def compile_one(number: int) -> None:
        compiler.run([*common, "-c", names[number], "-o", objects[number]], scratch)
        done.append(number)
        on_progress("compiling", len(done) / (len(names) + 1))

    done: list[int] = []
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        for _ in pool.map(compile_one, range(len(names))):
            pass
    on_progress("linking", len(names) / (len(names) + 1))
    script = ["-T", f"board/{board.linker_script}"]
    flags = [*board.processor, "-mthumb", *board.compile, *LINK, "-Lboard", *board.link]
    compiler.run([*flags, *script, "-o", "program.elf", *objects, "-lm"], scratch)
    on_progress("linking", 1.0)
    content = (scratch / "program.elf").read_bytes()
    return content if board.sealed_behind is None else seal(content, board.sealed_behind)


def _write_files(
    request: BuildRequest,
    board: Board,
    compiler: Compiler,
    config: BoardConfig,
    content: bytes,
    segments: tuple[Segment, ...],
    settings: Mapping[str, SettingValue],
    step_a: float | None,
) -> BuildResult:
    flash_bytes, ram_bytes = _sizes(board, segments)
    loaded = tuple(segment.load for segment in segments if segment.load.data)
    image = flat(loaded)
    suffix = "" if request.application == DEVICE else f"-{request.application}"
    stem = request.output / f"haptic-rig-{board.name}-{_file_name(request.model.name)}{suffix}"
    paths = {kind: stem.with_name(f"{stem.name}.{kind}") for kind in ("elf", "bin", "uf2", "json")}
    dictionary = config.record.dictionary
    budget = tick_budget(board, settings) if request.application == DEVICE else None
    result = BuildResult(
        board=board.name,
        rig=request.model.name,
        application=request.application,
        firmware=dictionary.firmware,
        protocol=f"{dictionary.major}.{dictionary.minor}",
        dictionary_hash=f"{config.record.dictionary_hash:016x}",
        compiler=compiler.version,
        settings=config.record.facts.settings,
        quantum_a=request.model.amplifier.current_quantum_a,
        set_point_step_a=step_a,
        elf=paths["elf"],
        bin=paths["bin"],
        uf2=None if board.uf2_family is None else paths["uf2"],
        facts=paths["json"],
        flash_bytes=flash_bytes,
        flash_room=board.flash.bytes,
        ram_bytes=ram_bytes,
        ram_room=board.ram.bytes,
        sha256=hashlib.sha256(image).hexdigest(),
        ticks={} if budget is None else {name: budget.text(name) for name in (INTEGERS, "fdm-butterworth")},
        warnings=_warnings(request, budget, step_a),
    )
    facts = {
        name: value for name, value in plain(result).items() if name not in ("elf", "bin", "uf2", "facts")
    }
    try:
        paths["elf"].write_bytes(content)
        paths["bin"].write_bytes(image)
        if board.uf2_family is not None:
            paths["uf2"].write_bytes(write_uf2(loaded, board.uf2_family))
        paths["json"].write_text(json.dumps(facts, indent=2, ensure_ascii=False) + "\n", encoding="utf-8")
    except OSError as error:
        raise _write_error(request.output, error) from None
    return result


def _make_directory(directory: Path) -> None:
    try:
        directory.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise _write_error(directory, error) from None


def _write_error(directory: Path, error: OSError) -> RecordingError:
    return RecordingError(
        f"the image cannot be written to {directory}: {error.strerror or error}",
        remedy="give another directory with `output`",
    )


def _sizes(board: Board, segments: tuple[Segment, ...]) -> tuple[int, int]:
    """Return the flash and RAM that a program uses (bytes); raise `ToolchainError` for data outside of the flash."""
    flash, ram = board.flash, board.ram
    for segment in segments:
        begin = segment.load.address
        inside = flash.origin <= begin and begin + len(segment.load.data) <= flash.origin + flash.bytes
        if segment.load.data and not inside:
            raise ToolchainError(
                f"the program has initialised data at {begin:#x}, where board {board.name} has no flash",
                remedy="place it in flash (`AT >` in the linker script), and copy it in the start-up code",
            )
    stored = [one for one in segments if flash.origin <= one.load.address < flash.origin + flash.bytes]
    flash_bytes = max((one.load.address + len(one.load.data) - flash.origin for one in stored), default=0)
    in_ram = [one for one in segments if ram.origin <= one.address < ram.origin + ram.bytes]
    ram_bytes = sum(one.memory_bytes for one in in_ram)
    return flash_bytes, ram_bytes


def _file_name(rig: str) -> str:
    return "".join(character if character.isalnum() or character in "-_" else "-" for character in rig)
