"""Heavy libraries, each imported when one of its names is first used.

`from rig.core.deferred import signal` at the top of a file costs nothing; `signal.csd(…)` loads scipy.signal, which
takes most of a second. So a command loads only the libraries that it uses, and imports stay at the top of each file.

Files of all packages import heavy libraries from here. This file must not import a library before one of its names is
used.
"""

from importlib import import_module
from typing import Any


class _Deferred:
    def __init__(self, name: str) -> None:
        self._name = name
        self._module: Any = None

    def __getattr__(self, attribute: str) -> Any:
        if self._module is None:
            self._module = import_module(self._name)
        return getattr(self._module, attribute)


integrate: Any = _Deferred("scipy.integrate")
io: Any = _Deferred("scipy.io")
linalg: Any = _Deferred("scipy.linalg")
optimize: Any = _Deferred("scipy.optimize")
signal: Any = _Deferred("scipy.signal")
special: Any = _Deferred("scipy.special")
stats: Any = _Deferred("scipy.stats")
pandas: Any = _Deferred("pandas")
xarray: Any = _Deferred("xarray")
pyarrow: Any = _Deferred("pyarrow")
parquet: Any = _Deferred("pyarrow.parquet")
csv: Any = _Deferred("pyarrow.csv")
agg: Any = _Deferred("matplotlib.backends.backend_agg")
colors: Any = _Deferred("matplotlib.colors")
figures: Any = _Deferred("matplotlib.figure")
matplotlib: Any = _Deferred("matplotlib")
serial: Any = _Deferred("serial")
usb: Any = _Deferred("usb.core")
metadata: Any = _Deferred("importlib.metadata")
jinja2: Any = _Deferred("jinja2")
markupsafe: Any = _Deferred("markupsafe")
pydantic: Any = _Deferred("pydantic")
linear_model: Any = _Deferred("statsmodels.regression.linear_model")
mixed_linear_model: Any = _Deferred("statsmodels.regression.mixed_linear_model")
mcap: Any = _Deferred("mcap.writer")
unicorn: Any = _Deferred("unicorn")
