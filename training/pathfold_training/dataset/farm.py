"""Rendering many views at once: processes of this machine, or the workers of a Dask cluster.

Both give every task once with what became of it, `render_view`'s result or the reason why there is none, in the order
in which they finish. A process or worker that dies in mid-view costs that view a retry and nothing else.
"""

from __future__ import annotations

import multiprocessing
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection, wait
from typing import Any, cast

from ..scenes.faults import RejectedError
from .store import Arrays, Line
from .trace import Task, render_view

Result = tuple[Line, Arrays] | str
STUCK = 1200  # seconds after which a view's process is given up
RETRIES = 1  # of a view whose process died; Dask has its own count, `distributed.scheduler.allowed-failures`
ANSWER = 10  # seconds for a scheduler to answer
PATIENCE = 60  # seconds to wait for a cluster's first worker


def attempt(task: Task) -> Result:
    """Renders the view, or says why it cannot be."""
    try:
        return render_view(task)
    except RejectedError as error:
        return str(error)
    except Exception as error:
        return f"{type(error).__name__}: {error}"


def local(tasks: list[Task], workers: int, work: Callable[[Task], Result] = attempt) -> Iterator[tuple[Task, Result]]:
    """Each view in a process of its own, `workers` at a time: scenes are freed for good."""
    context = multiprocessing.get_context("spawn")
    waiting = [(task, RETRIES) for task in reversed(tasks)]
    running: dict[Any, tuple[Any, Task, int, float]] = {}
    try:
        while waiting or running:
            while waiting and len(running) < workers:
                task, retries = waiting.pop()
                mine, theirs = context.Pipe(duplex=False)
                process = context.Process(target=_answer, args=(work, task, theirs), daemon=True)
                process.start()
                theirs.close()
                running[mine] = process, task, retries, time.monotonic()
            for ready in wait(list(running), timeout=5):
                pipe = cast(Connection, ready)
                process, task, retries, _ = running.pop(pipe)
                result: Result | None
                try:
                    result = pipe.recv()
                except (EOFError, OSError):  # it died before all was sent
                    result = None
                process.join()
                pipe.close()
                if result is None and retries:
                    waiting.append((task, retries - 1))
                else:
                    yield task, result or f"its process died with exit code {process.exitcode}, {RETRIES + 1} times"
            for pipe, (process, task, _, start) in list(running.items()):
                if time.monotonic() - start > STUCK:
                    process.kill()
                    del running[pipe]
                    yield task, f"given up after {STUCK} s"
    finally:
        for process, *_ in running.values():
            process.kill()


def _answer(work: Callable[[Task], Result], task: Task, pipe: Connection) -> None:
    with suppress(BrokenPipeError):  # nobody is left to hear it
        pipe.send(work(task))


def cluster(tasks: list[Task], address: str) -> Iterator[tuple[Task, Result]]:
    """The same on the workers that have joined the Dask scheduler at `address`. Raises OSError where there is none."""
    from distributed import Client, as_completed

    try:
        client = Client(address, timeout=ANSWER)
    except (OSError, ValueError) as error:
        raise OSError(f"no Dask scheduler answers at {address} ({error}); start one with `dask scheduler`") from error
    with client:
        try:
            client.wait_for_workers(1, timeout=PATIENCE)
        except TimeoutError as error:
            raise OSError(
                f"the scheduler at {address} has no worker; start some with `dask worker {address} --nthreads 1`"
            ) from error
        futures = {client.submit(attempt, task, pure=False): task for task in tasks}
        for future in as_completed(list(futures)):
            task = futures.pop(future)
            failure = future.exception()
            yield task, f"{type(failure).__name__}: {failure}" if failure else future.result()
            future.release()
