import inspect
import subprocess
import sys

from geoaim.base.defaults import SAMPLES
from geoaim.cli import COMMANDS
from geoaim.prediction import predict


def test_command_and_library_draw_the_same_number_of_futures():
    commands = {command.__name__: command for command in COMMANDS}
    functions = (predict, commands["predict"], commands["evaluate"])
    defaults = [inspect.signature(function).parameters["samples"].default for function in functions]
    assert defaults == 3 * [SAMPLES]


def test_the_command_line_starts_without_torch():
    code = "import sys, geoaim.cli; raise SystemExit('torch' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
