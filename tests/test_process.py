"""pathfold in somebody's process: signals, threads, the interpreter's end and forks, each in a process of its own.

Nothing here asserts a time but that of a process that hangs.
"""

import subprocess
import sys
import textwrap
import time
from pathlib import Path

import numpy as np
import pathfold
import pytest

LONG = 240  # seconds, on a machine that is busy: until then it hangs
HEAD = """
import multiprocessing, os, signal, sys, threading, time
import numpy as np
import pathfold

small = np.random.default_rng(0).random((64, 64, 3), np.float32)
large = np.broadcast_to(np.float32(0.5), (16384, 16384, 3))  # minutes of work, no memory
denoiser = pathfold.Denoiser("single-21", threads=2, leave_out="none")
right = denoiser.run(small).color
print("ready", flush=True)
"""


def start(code: str, before: str = "") -> subprocess.Popen[str]:
    program = before + HEAD + textwrap.dedent(code)
    return subprocess.Popen(
        [sys.executable, "-W", "ignore", "-c", program], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )


def end(process: subprocess.Popen[str]) -> str:
    """What it printed after "ready"; fails where it hangs or ends by a signal or an error."""
    try:
        out, errors = process.communicate(timeout=LONG)
    except subprocess.TimeoutExpired:
        process.kill()
        pytest.fail("it hangs")
    assert process.returncode == 0, errors[-2000:]
    return out.replace("ready\n", "")


def interrupt(code: str) -> str:
    """Sends Ctrl-C some time after the process has said that it runs."""
    process = start(code)
    assert process.stdout
    while process.stdout.readline() != "running\n":
        assert process.poll() is None
    time.sleep(0.5)
    process.send_signal(2)
    return end(process)


INTERRUPTED = """
print("running", flush=True)
try:
    {}
except KeyboardInterrupt:
    print("interrupted", flush=True)
{}
"""


@pytest.mark.parametrize("progress", ["", ", progress=lambda done: None"])
def test_interrupt_ends_a_run(tiny: Path, progress: str) -> None:
    code = INTERRUPTED.format(
        f"denoiser.run(large{progress})", "print(np.array_equal(denoiser.run(small).color, right))"
    )
    assert interrupt(code) == "interrupted\nTrue\n"


def test_interrupt_ends_one_large_tile(tiny: Path) -> None:
    code = "large = large[:4096, :4096]; denoiser = pathfold.Denoiser(denoiser.model, tile=4096)\n"
    code += INTERRUPTED.format("while True: denoiser.run(large)", "")
    assert interrupt(code) == "interrupted\n"


def test_interrupt_ends_the_wait_for_a_turn(tiny: Path) -> None:
    code = """
    threading.Thread(target=denoiser.run, args=(large,), daemon=True).start()
    time.sleep(0.5)
    """
    assert interrupt(textwrap.dedent(code) + INTERRUPTED.format("denoiser.run(small)", "")) == "interrupted\n"


def test_other_handlers_of_signals_run_meanwhile(tiny: Path) -> None:
    code = """
    class Asked(Exception): pass
    def ask(*_): raise Asked
    signal.signal(signal.SIGALRM, ask)
    signal.setitimer(signal.ITIMER_REAL, 0.5)
    try:
        denoiser.run(large)
    except Asked:
        print("asked")
    """
    assert end(start(code)) == "asked\n"


@pytest.mark.parametrize(
    "target",
    [
        "lambda: denoiser.run(large)",
        "lambda: denoiser.run(large, progress=lambda done: None)",
        "lambda: [denoiser.run(small) for _ in iter(int, 1)]",
        "lambda: [denoiser.run(small, progress=lambda done: None) for _ in iter(int, 1)]",
        "lambda: [pathfold.Denoiser('single-3', threads=1).run(small) for _ in iter(int, 1)]",
        "lambda: [pathfold.auto_exposure(small) for _ in iter(int, 1)]",
    ],
)
def test_the_interpreter_ends_while_daemon_threads_denoise(tiny: Path, target: str) -> None:
    code = f"""
    for _ in range(3):
        threading.Thread(target={target}, daemon=True).start()
    time.sleep(0.5)
    """
    assert end(start(code)) == ""


def test_functions_that_run_at_the_end_may_denoise(tiny: Path) -> None:
    # Registered before pathfold's own, so it runs after that.
    last = "import atexit\natexit.register(lambda: print(np.array_equal(denoiser.run(small).color, right)))\n"
    code = """
    threading.Thread(target=denoiser.run, args=(large,), daemon=True).start()
    time.sleep(0.5)
    """
    assert end(start(code, before=last)) == "True\n"


FORKED = """
child = os.fork()
if child == 0:
    {}
    os._exit(0) if not {} else sys.exit(0)
print(os.waitpid(child, 0)[1], np.array_equal(denoiser.run(small).color, right))
"""


@pytest.mark.parametrize("leaves", [False, True])
@pytest.mark.parametrize(
    "body",
    [
        "pass",
        "del denoiser; import gc; gc.collect()",
        "assert np.array_equal(denoiser.run(small).color, right)",
        "assert np.array_equal(pathfold.Denoiser(denoiser.model, leave_out='none').run(small).color, right)",
        "[pathfold.denoise(small, model=name) for name in ('trust-5', 'split-5', 'steep-5', 'single-3', 'single-21')]",
    ],
)
def test_a_child_denoises_and_ends(tiny: Path, body: str, leaves: bool) -> None:
    code = "pathfold.denoise(small, model='single-3')\npathfold.denoise(small, model='single-21', threads=1)\n"
    assert end(start(code + FORKED.format(body, leaves))) == "0 True\n"


def test_a_child_of_a_process_that_denoises(tiny: Path) -> None:
    code = """
    threading.Thread(target=denoiser.run, args=(large,), daemon=True).start()
    time.sleep(0.5)
    child = os.fork()
    if child == 0:
        try:
            denoiser.run(small)
        except pathfold.PathfoldError as error:
            assert error.code == "invalid-argument" and "forked" in str(error), error
        else:
            os._exit(2)
        del denoiser
        assert pathfold.denoise(small, model="single-21").shape == small.shape
        sys.exit(0)
    print(os.waitpid(child, 0)[1])
    """
    assert end(start(code)) == "0\n"


def test_a_pool_of_processes(tiny: Path) -> None:
    code = """
    pathfold.denoise(small, model="single-21")
    def work(number):
        mine = pathfold.denoise(small, model="single-21", leave_out="none")
        return np.array_equal(mine, right), np.array_equal(denoiser.run(small).color, right)
    with multiprocessing.get_context("fork").Pool(2) as pool:
        print(pool.map(work, range(4)) == 4 * [(True, True)])
    """
    assert end(start(code)) == "True\n"


def test_what_is_false_cancels(tiny: Path) -> None:
    denoiser = pathfold.Denoiser("single-3", tile=16)
    color = np.ones((32, 48, 3), np.float32)
    for answer in (False, 0, np.False_, np.int32(0), 0.0):
        with pytest.raises(pathfold.PathfoldError, match="cancelled"):
            denoiser.run(color, progress=lambda done, answer=answer: answer)
    for answer in (None, True, 1, np.True_, "on"):
        denoiser.run(color, progress=lambda done, answer=answer: answer)
    with pytest.raises(ValueError, match="ambiguous"):
        denoiser.run(color, progress=lambda done: np.ones(2))


def test_threads_beyond_the_processors_are_told(tiny: Path) -> None:
    color = np.ones((32, 48, 3), np.float32)
    report = pathfold.Denoiser("single-3", threads=1024).run(color).report
    assert report["threads"] < 1024
    assert any("1024 threads were asked for" in note for note in report["notes"])
    assert not any("threads" in note for note in pathfold.Denoiser("single-3", threads=1).run(color).report["notes"])
