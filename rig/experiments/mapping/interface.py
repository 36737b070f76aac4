"""Re-export the public names of this package: maps of hits and of impedances, their plans and results, and theory.

Commands, pages, plots and papers import this module. It defines nothing, and no file of this package imports it, so
that a single measured impedance or a table of limit cycles does not import every kind of map.
"""

from rig.experiments.hits._on_device import OnDevice
from rig.experiments.mapping._kmax import KMax, kmax_plan
from rig.experiments.mapping._map_request import MapRequest
from rig.experiments.mapping._maps import (
    JOURNAL,
    PLAN,
    RECORDINGS,
    SUMMARY,
    directory_for,
    map_into,
    map_on_rig,
    read_plan,
    recorded_hit,
    summary,
    write_map,
    zwidth,
)
from rig.experiments.mapping._ranges import (
    PAPERS_SCHEMES,
    frequency_plan,
    highest_stiffness,
    hit_plan,
    kmax_theory,
    linear_curves,
    passive_limit,
    search_for,
    theory_curves,
)
from rig.experiments.mapping._rendering import RENDERED
from rig.experiments.mapping._searches import (
    GridSearch,
    Outcomes,
    Passes,
    StiffnessSearch,
    Way,
    check_values,
    connected,
    drive,
    limit_of,
    numbers_of,
    trace_grid,
)
from rig.experiments.mapping._zwidth_rig import RECORDING, DeviceMap, Next, work_of, zwidth_on_rig
from rig.experiments.mapping.impedance import Judging
from rig.experiments.mapping.table_one import (
    PAPER,
    FrequencyWidth,
    Printed,
    SchemeRow,
    Spread,
    TableOne,
    table_one,
    tuned_numbers,
)
from rig.experiments.mapping.zwidth import TRUE, Boundary, MapPlan, Series, Width, ZWidth, run_series
from rig.experiments.mapping.zwidth_frequency import TOGETHER, FrequencyMap, FrequencyPlan

__all__ = [
    "JOURNAL",
    "PAPER",
    "PAPERS_SCHEMES",
    "PLAN",
    "RECORDING",
    "RECORDINGS",
    "RENDERED",
    "SUMMARY",
    "TOGETHER",
    "TRUE",
    "Boundary",
    "DeviceMap",
    "FrequencyMap",
    "FrequencyPlan",
    "FrequencyWidth",
    "GridSearch",
    "Judging",
    "KMax",
    "MapPlan",
    "MapRequest",
    "Next",
    "OnDevice",
    "Outcomes",
    "Passes",
    "Printed",
    "SchemeRow",
    "Series",
    "Spread",
    "StiffnessSearch",
    "TableOne",
    "Way",
    "Width",
    "ZWidth",
    "check_values",
    "connected",
    "directory_for",
    "drive",
    "frequency_plan",
    "highest_stiffness",
    "hit_plan",
    "kmax_plan",
    "kmax_theory",
    "limit_of",
    "linear_curves",
    "map_into",
    "map_on_rig",
    "numbers_of",
    "passive_limit",
    "read_plan",
    "recorded_hit",
    "run_series",
    "search_for",
    "summary",
    "table_one",
    "theory_curves",
    "trace_grid",
    "tuned_numbers",
    "work_of",
    "write_map",
    "zwidth",
    "zwidth_on_rig",
]
