"""A command goes on and writes its files after the reader of its output, such as `head`, has gone."""

import shlex
import subprocess
import sys

SPEAKS = """
import sys
from medjax.commandline import command

@command
def main(argv):
    for number in range(20_000):
        print(number)
        print(number, file=sys.stderr)
    open("done", "w").close()
    return 3

sys.exit(main())
"""


def test_any_command_goes_on(tmp_path):
    """It prints far more than a pipe holds to both streams, and keeps its own exit code."""
    (tmp_path / "speaks.py").write_text(SPEAKS)
    words = [sys.executable, "-u", "-m", "speaks"]
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    with subprocess.Popen(words, cwd=tmp_path, text=True, **pipes) as process:
        process.stdout.readline()
        process.stdout.close()
        assert process.wait(timeout=60) == 3
    assert (tmp_path / "done").exists()


def test_a_command_without_streams_goes_on(tmp_path):
    """A shell's `>&-` closes them; Python then has None for both."""
    (tmp_path / "speaks.py").write_text(SPEAKS)
    shell = f"{shlex.quote(sys.executable)} -m speaks >&- 2>&-"
    assert subprocess.run(shell, shell=True, cwd=tmp_path, check=False, timeout=60).returncode == 3
    assert (tmp_path / "done").exists()
