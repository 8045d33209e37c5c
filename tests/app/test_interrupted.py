"""Ctrl-C at chosen instants of a program of its own ends it with a word, never with a traceback.

``python -m tests.app.interrupting`` does the same at instants of the wall clock, for every command.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from groundstation.app.cli import COMMANDS
from groundstation.app.stopped import STOPPED, STOPPED_JSON, STOPPED_WORDS

_AT = """
import os, signal, sys
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            os.write(2, b"reached\\n")
            try:
                os.kill(os.getpid(), signal.SIGINT)
            except KeyboardInterrupt:  # as compiled modules do
                raise ImportError("initialization failed") from None
sys.meta_path.insert(0, Finder())
sys.argv = ["gs", *sys.argv[1:]]
from groundstation.__main__ import main
main()
"""
"""Ctrl-C in the instant at which a module is about to be loaded."""


def _run(code: str, line: str, folder: Path, timeout_s: float = 120.0) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *line.split()],
        cwd=folder,
        env=os.environ | {"HOME": str(folder)},
        capture_output=True,
        text=True,
        check=False,
        timeout=timeout_s,
    )


@pytest.mark.parametrize("command", COMMANDS)
def test_ctrl_c_while_a_command_is_loaded_is_a_word(command: str, tmp_path: Path) -> None:
    done = _run(_AT.format(module=f"groundstation.app.commands.{COMMANDS[command][0]}"), command, tmp_path)
    assert (done.returncode, done.stderr) == (STOPPED, "reached\n" + STOPPED_WORDS)


@pytest.mark.parametrize(
    ("line", "module"),
    [
        ("missions", "yaml"),
        ("schema mission", "pydantic"),
        ("sitl-env px4_cube8", "scipy.optimize"),
        ("fly --mission hello1 --dry-run --log flight.tlog", "scipy.optimize._highspy._core"),
        ("design cube8 -o gains.npz", "clarabel"),
        ("campaign --mission hello1 --runs 1 --workers 0 -o out", "distributed"),
        ("gateway crazyflie -v 1=udp://127.0.0.1:19999", "cflib"),
    ],
)
def test_ctrl_c_that_a_compiled_module_would_hide_is_a_word_all_the_same(
    line: str, module: str, tmp_path: Path
) -> None:
    done = _run(_AT.format(module=module), line, tmp_path)
    assert (done.returncode, done.stderr) == (STOPPED, "reached\n" + STOPPED_WORDS)
    assert not [path for path in tmp_path.rglob("*") if path.is_file()]


def test_ctrl_c_is_answered_in_json_where_that_was_asked_for(tmp_path: Path) -> None:
    done = _run(_AT.format(module="scipy.optimize"), "fly --mission hello1 --dry-run --json", tmp_path)
    assert (done.returncode, done.stdout) == (STOPPED, STOPPED_JSON)


def _program(stands_in: str, *, before: str = "") -> str:
    """A program whose command line is another, run as the script that pip makes of an entry point runs it."""
    return (
        f"import os, signal, sys\n{before}\n"
        "from groundstation.__main__ import main\nimport groundstation.app.cli as cli\n"
        "def press(): os.kill(os.getpid(), signal.SIGINT)\n"
        f"def work():\n    {stands_in}\ncli.main = work\nmain()\nprint('went on')\n"
    )


def test_ctrl_c_before_the_command_line_is_called_is_a_word(tmp_path: Path) -> None:
    code = "import os, signal, groundstation.__main__\nos.kill(os.getpid(), signal.SIGINT)\nprint('went on')"
    done = _run(code, "", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (STOPPED, "", STOPPED_WORDS)


def test_ctrl_c_that_python_would_forget_is_raised_again(tmp_path: Path) -> None:
    finalizer = "type('Thing', (), {'__del__': lambda self: press()})(); [signal.pause() for _ in range(100)]"
    done = _run(_program(finalizer), "", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (STOPPED, "", STOPPED_WORDS)


def test_what_comes_of_ctrl_c_is_no_fault_of_the_program_and_other_faults_are(tmp_path: Path) -> None:
    hidden = "\n    try: press(); signal.pause()\n    except KeyboardInterrupt: raise ValueError('of it') from None"
    done = _run(_program(hidden), "", tmp_path)
    assert (done.returncode, done.stderr) == (STOPPED, STOPPED_WORDS)
    done = _run(_program("raise ValueError('a fault')"), "", tmp_path)
    assert (done.returncode, done.stderr.splitlines()[-1]) == (1, "ValueError: a fault")


def test_ctrl_c_while_python_takes_itself_apart_says_nothing(tmp_path: Path) -> None:
    done = _run(_program("import atexit; atexit.register(press)"), "", tmp_path)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, "")


_EVERY_LINE = """
    import groundstation.__main__ as entry
    def tracer(frame, event, _):
        if frame.f_code.co_name in ("main", "end") and "groundstation" in frame.f_code.co_filename:
            if entry._CTRL_C.over:
                os.write(1, b"pressed ")
                press()
        return tracer
    sys.settrace(tracer); sys._getframe(1).f_trace = tracer
"""
"""Ctrl-C at every line of the entry point once a command has ended."""


@pytest.mark.parametrize(("ends", "code"), [("pass", 0), ("sys.exit(3)", 3), ("sys.exit(0)", 0)])
def test_ctrl_c_at_any_line_after_a_command_is_no_traceback(ends: str, code: int, tmp_path: Path) -> None:
    done = _run(_program(_EVERY_LINE + f"    {ends}"), "", tmp_path)
    assert done.stdout.startswith("pressed ")
    assert (done.returncode, done.stderr) in ((code, ""), (-signal.SIGINT, ""))


def test_a_program_that_is_to_ignore_ctrl_c_goes_on(tmp_path: Path) -> None:
    done = _run(_program("press()", before="signal.signal(signal.SIGINT, signal.SIG_IGN)"), "", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "went on\n", "")


def test_what_was_forgotten_is_told_to_the_command_that_looks_after_ctrl_c_by_then(tmp_path: Path) -> None:
    """A flight that has begun comes home by it and is not ended."""
    taken = (
        "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGALRM})"
        "\n    type('Thing', (), {'__del__': lambda self: press()})()"
        "\n    signal.signal(signal.SIGINT, lambda *_: print('it comes home'))"
        "\n    signal.sigwait({signal.SIGALRM}); signal.raise_signal(signal.SIGALRM)"
        "\n    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGALRM})"
    )
    done = _run(_program(taken), "", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (0, "it comes home\nwent on\n", "")


def test_a_second_ctrl_c_while_modules_are_loaded_ends_at_once(tmp_path: Path) -> None:
    (tmp_path / "slowly.py").write_text("import os, signal\nfor _ in (1, 2): os.kill(os.getpid(), signal.SIGINT)\n")
    code = _program("import slowly; print('loaded')", before=f"sys.path.insert(0, {str(tmp_path)!r})")
    done = _run(code, "", tmp_path)
    assert (done.returncode, done.stdout, done.stderr) == (STOPPED, "", STOPPED_WORDS)
