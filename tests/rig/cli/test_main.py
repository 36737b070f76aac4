"""Ctrl-C before the commands are loaded ends the program as Ctrl-C in a running command does."""

import subprocess
import sys

PROGRAM = """
import sys

class Interrupted:
    def find_spec(self, name, *_):
        if name == "click":
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupted())
sys.argv = ["rig", "hit"]
from rig.__main__ import main
main()
"""


def test_an_interrupt_while_a_command_is_loaded_is_a_stop() -> None:
    done = subprocess.run([sys.executable, "-P", "-c", PROGRAM], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (130, "\nrig: stopped\n")
