"""The process of a job (a run, a session or a map), so that no control loop shares a process with the page's server.

``python -P -m rig.extras.console job``: the first line of standard input is the job. Each further line is an answer to
a question of the job, or an empty line, the heartbeat. The end of input means that the console has ended, and 2 s of
silence that the console hangs. Each line of standard output is one message:

=========  =======================================================================================
say        content
=========  =======================================================================================
compiling  true while machine code is being compiled
progress   state of the job while it runs
asks       a question to the operator; the next line of input answers it
done       result of the job; the process ends
failed     why the job ended early (`RigError.as_mapping`); the process ends
=========  =======================================================================================

If its console has ended, a job ends as after a STOP, unless it was started as detached.
"""

import json
import signal
import sys
import threading
from collections.abc import Callable, Mapping
from typing import Any

from rig.core.errors import RigError, StoppedError
from rig.extras.console import devices, hits, map_jobs, session_desk
from rig.extras.console.talk import Talk
from rig.realtime import compiling

Work = Callable[[Mapping[str, Any], Talk], Any]
JOBS: Mapping[str, Work] = {
    "doctor": devices.doctor,
    "hit": hits.hit,
    "map": map_jobs.zwidth,
    "play": hits.play,
    "session": session_desk.session,
}


def main() -> int:
    """Run the job (run, session or map) that standard input describes; return the exit code of the process."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    job: Mapping[str, Any] = json.loads(sys.stdin.readline())
    talk = Talk(bool(job.get("is_detached")))
    threading.Thread(target=talk.listen, name="rig-console", daemon=True).start()
    compiling.listen(lambda busy: talk.tell("compiling", busy=busy))
    try:
        result = JOBS[job["job"]](job["content"], talk)
    except RigError as error:
        talk.tell("failed", **error.as_mapping())
        return error.exit_code
    except KeyboardInterrupt:
        talk.tell(
            "failed", **StoppedError("stopped outside of a run; earlier recordings are complete").as_mapping()
        )
        return 130
    talk.tell("done", result=result)
    return 0
