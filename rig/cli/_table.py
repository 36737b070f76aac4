"""Table of the core's commands and their modules, by the titles of ``rig --help``; less frequent ones are in groups.

Commands of extras are in the extras' tables (`rig.core.extras`). `rig.cli.completion_table` writes the texts that
shells and ``--help`` show of all commands.
"""

from rig.cli._lazy import Table

TITLES: dict[str, Table] = {
    "Run": {
        "experiment": (
            "Write an experiment file, check what it will do, list the built-in rigs.",
            {
                "new": "rig.cli.new:new",
                "plan": "rig.cli.plan:plan",
                "preset": "rig.cli.preset:preset",
                "schema": "rig.cli.preset:schema",
            },
        ),
        "hit": "rig.cli.hit:hit",
    },
    "Measure a rig": {
        "identify": "rig.cli.identify:identify",
        "impedance": (
            "Measure the impedance that a rig renders at a wall, or map where it is passive and how faithful.",
            {"measure": "rig.cli.impedance:measure", "map": "rig.cli.impedance_map:map_"},
        ),
    },
    "Rates and estimators": {
        "compare": "rig.cli.compare:compare",
        "zwidth": "rig.cli.zwidth:zwidth",
        "design": "rig.cli.design:design_",
        "theory": (
            "Compute the limits of a rig's walls and of an estimator's gains by theory, and where "
            "hits differ from them.",
            {
                "walls": "rig.cli.theory:walls",
            },
        ),
        "estimators": (
            "List, compare and tune velocity estimators, and export one as C code.",
            {
                "list": "rig.cli.estimators:list_",
                "compare": "rig.cli.estimators:compare",
                "tune": "rig.cli.estimators:tune",
                "export": "rig.cli.estimators:export",
                "lipschitz": "rig.cli.estimators:lipschitz",
            },
        ),
    },
    "People": {
        "session": (
            "Run wall-hit experiments with people: protocol, sessions, analysis.\n\n"
            "Without hardware: `rig session new study.toml`, then `rig session run study.toml P01 --rehearse`.",
            {
                "new": "rig.cli.session_protocol:new",
                "check": "rig.cli.session_protocol:check",
                "run": "rig.cli.session_run:run",
                "resume": "rig.cli.session_run:resume",
                "show": "rig.cli.session_run:show",
                "amend": "rig.cli.session_run:amend",
                "schema": "rig.cli.session_protocol:schema",
            },
        ),
    },
    "Recordings": {
        "show": "rig.cli.show:show",
        "recording": (
            "Show, replay, export, import and recover recordings; `rig show` is short for `rig recording show`.",
            {
                "show": "rig.cli.show:show",
                "timing": "rig.cli.timing:timing",
                "replay": "rig.cli.replay:replay",
                "export": "rig.cli.export:export",
                "import": "rig.cli.import_counts:import_counts",
                "recover": "rig.cli.recover:recover",
            },
        ),
    },
    "Hardware": {
        "device": (
            "List and identify devices; check the connected rig, and find its position zero.",
            {
                "list": "rig.cli.device:list_",
                "show": "rig.cli.device:show",
                "parameters": "rig.cli.device:parameters",
                "check": "rig.cli.check:check",
                "reference": "rig.cli.reference:reference",
            },
        ),
        "doctor": "rig.cli.doctor:doctor",
        "firmware": (
            "Build the firmware of a controller board for a rig, inspect it, flash it, have it test itself.",
            {
                "build": "rig.cli.firmware:build",
                "amplifiers": "rig.cli.firmware:amplifiers",
                "wiring": "rig.cli.firmware:wiring",
                "info": "rig.cli.firmware:info",
                "flash": "rig.cli.firmware:flash",
                "selftest": "rig.cli.firmware:selftest",
                "check-port": "rig.cli.firmware:check_port",
            },
        ),
        "serve": (
            "Serve a simulated rig, a bridge to a drive, streams for Lab Streaming Layer, or these documents.",
            {
                "rig": "rig.cli.serve_rig:serve",
                "docs": "rig.cli.docs:docs",
            },
        ),
    },
    "Live": {
        "stop": "rig.cli.stop:stop",
        "set": "rig.cli.set:set_",
    },
}
