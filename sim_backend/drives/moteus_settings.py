"""Store the settings of a moteus by name, and simulate the console that reads and changes them.

The file follows docs/reference/configuration.md and docs/protocol/diagnostic.md of mjbots/moteus (`conf …`, `tel …`,
`d …`), with the replies of mjlib/micro/persistent_config.cc. Settings that the simulation does not use are unknown
names.
"""

import math
from collections.abc import Callable, Mapping

Value = int | float

ONBOARD_COUNTS = 16384  # docs/reference/configuration.md, aux[12].spi.mode 0
SPI, QUADRATURE = 1, 3  # docs/reference/configuration.md, motor_position.sources.X.type
PHASE_OHM = 0.05  # phase to star point, assumed; only the mode "brake" depends on it
# N·m/A times rev/min/V: fw/bldc_servo.cc, kTorqueFactor
TORQUE_TIMES_KV = 1.5 / math.sqrt(3.0) * 60.0 / (2.0 * math.pi)


def defaults(counts_per_turn: int, torque_constant: float) -> dict[str, Value]:
    """Return the settings of a calibrated moteus by name, for an encoder and a torque constant (N·m/A at the shaft).

    With 2¹⁴ counts per turn the encoder is the one on the board, otherwise a quadrature encoder on aux1. If a setting
    of sign is changed later, the drive behaves as calibrated again: a positive torque turns towards greater positions.
    """
    # Defaults of the firmware (fw/bldc_servo_structs.h at db1a762) but for what calibration finds (motor, encoder) and
    # what the maker sets by hand for a drive that turns freely: no bounds of position.
    onboard = counts_per_turn == ONBOARD_COUNTS
    return {
        "id.id": 1,
        "can.prefix": 0,
        "servo.pwm_rate_hz": 30000,
        "servo.max_voltage": 56.0,
        "servo.fault_temperature": 75.0,
        "servo.fault_position_error": math.nan,
        "servo.fault_velocity_error": math.nan,
        "servo.velocity_threshold": 0.0,
        "servo.position_derate": 0.02,
        "servo.pid_position.kp": 4.0,
        "servo.pid_position.ki": 1.0,
        "servo.pid_position.kd": 0.05,
        "servo.pid_position.iratelimit": -1.0,
        "servo.pid_position.ilimit": 0.0,
        "servo.pid_position.max_desired_rate": 0.0,
        "servo.pid_position.sign": 1,
        "servo.default_velocity_limit": math.nan,
        "servo.default_accel_limit": 50.0,
        "servo.inertia_feedforward": 0.0,
        "servo.voltage_mode_control": 0,
        "servo.fixed_voltage_mode": 0,
        "servo.max_position_slip": math.nan,
        "servo.max_velocity_slip": math.nan,
        "servo.default_timeout_s": 0.1,
        "servo.timeout_max_torque_Nm": 5.0,
        "servo.timeout_mode": 12,
        "servo.max_power_W": math.nan,
        "servo.max_current_A": 100.0,
        "servo.max_velocity": 500.0,
        "servo.max_velocity_derate": 2.0,
        "servopos.position_min": math.nan,
        "servopos.position_max": math.nan,
        "motor.poles": 14,
        "motor.resistance_ohm": PHASE_OHM,
        "motor.Kv": TORQUE_TIMES_KV / torque_constant,
        "aux1.spi.mode": 0 if onboard else 1,
        "aux1.quadrature.enabled": 0 if onboard else 1,
        "aux1.quadrature.cpr": counts_per_turn,
        "motor_position.sources.0.aux_number": 1,
        "motor_position.sources.0.type": SPI if onboard else QUADRATURE,
        "motor_position.sources.0.cpr": counts_per_turn,
        "motor_position.sources.0.offset": 0.0,
        "motor_position.sources.0.sign": 1,
        "motor_position.sources.0.reference": 0,
        "motor_position.sources.0.pll_filter_hz": 400.0,
        "motor_position.sources.1.type": 0,
        "motor_position.sources.2.type": 0,
        "motor_position.commutation_source": 0,
        "motor_position.output.source": 0,
        "motor_position.output.offset": 0.0,
        "motor_position.output.sign": 1,
        "motor_position.output.reference_source": -1,
        "motor_position.rotor_to_output_ratio": 1.0,
    }


class MoteusSettings:
    """The active settings of a moteus, and the settings in its persistent storage.

    Parameters
    ----------
    values
        Value of each setting by name; changes keep its type.
    """

    def __init__(self, values: Mapping[str, Value]) -> None:
        self.values = dict(values)
        self._factory, self._stored = dict(values), dict(values)
        self._updated: Callable[[], None] = lambda: None

    def watch(self, updated: Callable[[], None]) -> None:
        """Register a function that is called after each change of a setting."""
        self._updated = updated

    def set(self, name: str, text: str) -> bool:
        """Change an active setting; return False if the name is unknown or the text is not a number."""
        if name not in self.values:
            return False
        try:
            value = float(text)
            self.values[name] = int(value) if isinstance(self.values[name], int) else value
        except (ValueError, OverflowError):
            return False
        self._updated()
        return True

    def store(self) -> None:
        """Copy the active settings to persistent storage, as the console command ``conf write`` does."""
        self._stored = dict(self.values)

    def load(self) -> None:
        """Replace the active settings by the stored ones, as ``conf load`` and power-up do."""
        self.values = dict(self._stored)
        self._updated()

    def reset(self) -> None:
        """Replace the active settings by the maker's defaults, as ``conf default`` does."""
        self.values = dict(self._factory)
        self._updated()


def format_value(value: Value) -> str:
    """Return the value of a setting as the drive's console prints it."""
    return str(value) if isinstance(value, int) else f"{value:f}"


class DiagnosticChannel:
    """The console of a moteus (diagnostic channel 1): it receives lines and stores its replies.

    Parameters
    ----------
    settings
        Settings of the drive.
    order
        Executes the words of a command after ``d``; returns False if the command is not valid.
    """

    def __init__(self, settings: MoteusSettings, order: Callable[[list[str]], bool]) -> None:
        self._settings = settings
        self._order = order
        self._line = b""
        self.out = b""

    def hear(self, data: bytes) -> None:
        """Process bytes from the host as console input; a line ends at a carriage return or line feed."""
        *lines, self._line = (self._line + data).replace(b"\r", b"\n").split(b"\n")
        for line in lines:
            if line.strip():
                self.out += self._answer(line.decode("latin1").split()).encode("latin1")

    def say(self, most: int) -> bytes:
        """Remove and return at most `most` bytes of the console's waiting replies."""
        output, self.out = self.out[:most], self.out[most:]
        return output

    def _answer(self, words: list[str]) -> str:
        group, *rest = words
        if group == "conf" and rest:
            return self._conf(*rest)
        if group == "tel" and rest and rest[0] in {"stop", "text"}:
            return "OK\r\n"
        if group == "d" and rest:
            return "OK\r\n" if self._order(rest) else "ERR unknown command\r\n"
        return "ERR unknown command\r\n"

    def _conf(self, verb: str, *rest: str) -> str:
        settings = self._settings
        if verb == "get" and len(rest) == 1:
            return self._get(rest[0])
        if verb == "set" and len(rest) == 2:
            if not self._group(rest[0]):
                return "ERR unknown group\r\n"
            return "OK\r\n" if settings.set(*rest) else "ERR error setting\r\n"
        if verb == "enumerate":
            return "".join(f"{n} {format_value(v)}\r\n" for n, v in settings.values.items()) + "OK\r\n"
        acts = {"write": settings.store, "load": settings.load, "default": settings.reset}
        if verb not in acts:
            return "ERR unknown subcommand\r\n"
        acts[verb]()
        return "OK\r\n"

    def _get(self, name: str) -> str:
        if not self._group(name):
            return "ERR unknown group\r\n"
        if name not in self._settings.values:
            return "ERR error reading\r\n"
        return f"{format_value(self._settings.values[name])}\r\n"

    def _group(self, name: str) -> bool:
        group = name.partition(".")[0]
        return any(known.startswith(f"{group}.") for known in self._settings.values)
