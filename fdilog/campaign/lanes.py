"""Where work is done: each lane is one worker process of this machine.

A lane is a `concurrent.futures.Executor` and what that interface lacks: whom the death of a worker
concerns, and how to end what hangs. A lane of one process does its tasks in the order in which it
got them, so that the log which ended a worker is known, not guessed.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import (
    BrokenExecutor,
    CancelledError,
    Future,
    ProcessPoolExecutor,
)
from dataclasses import dataclass
from typing import Any, Protocol

from fdilog.errors import FdilogError

PRELOADED = "fdilog.campaign.warm"
SINGLE_THREADED = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
"""One log is one worker's work; threads of linear algebra would fight for the other's cores."""
QUEUED = 2
"""In a lane at once: the log that is analysed, and the next, so that no worker waits for us."""
STARTS = 3
"""So many workers in a row that die before their first log mean that none will ever start."""
FIRST_VICTIMS = "500"
"""Workers, not the parent, are what a machine out of memory is to end. (Linux, -1000 to 1000)"""


class WorkersError(FdilogError):
    """No worker can be had; nothing about any log."""


@dataclass(frozen=True, kw_only=True)
class Burial:
    """Whom the death of a worker concerns.

    Parameters
    ----------
    guilty
        The task that ended the worker.
    innocent
        Tasks that had not begun.
    unclear
        Tasks of which any may be guilty: each is to be done again with no other in its lane.
    """

    guilty: Future[Any] | None = None
    innocent: Sequence[Future[Any]] = ()
    unclear: Sequence[Future[Any]] = ()
    reason: str = ""


class Lane(Protocol):
    """Room for some tasks at once."""

    room: int

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Begin a task, or queue it."""

    def settle(self, future: Future[Any]) -> None:
        """Be told that a task's outcome was taken."""

    def running_since(self, future: Future[Any]) -> float | None:
        """Monotonic time at which a task began; None while it waits for its turn."""

    def bury(self, future: Future[Any]) -> Burial:
        """Say whom the death concerns that a task has met, and be ready for others again."""

    def end(self, future: Future[Any]) -> Burial:
        """End a task that hangs, whatever it takes."""

    def close(self, *, now: bool) -> None:
        """Let the workers go; now, or once they are done."""


class WorkerLane:
    """One worker process of our own, started anew whenever it dies.

    The process comes from a fork server, which has nothing but the imports, paid once: a fork of
    the parent would copy its threads' locks and its open database, and a spawned interpreter would
    import everything again after every death.

    Parameters
    ----------
    memory_bytes
        What the data of a worker may take; 0 for no limit.
    """

    room = QUEUED

    def __init__(self, memory_bytes: int = 0) -> None:
        self._memory_bytes = memory_bytes
        self._queue: deque[Future[Any]] = deque()
        self._failed_starts = 0
        self._start()

    def _start(self) -> None:
        self._head_since: float | None = None
        self._executor = ProcessPoolExecutor(
            1, mp_context=_context(), initializer=_prepare, initargs=(self._memory_bytes,)
        )
        before = multiprocessing.active_children()
        with _single_threaded():
            self._ready = self._executor.submit(os.getpid)  # starts the process
        started = [each for each in multiprocessing.active_children() if each not in before]
        self._process = started[0] if started else None

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Begin a task, or queue it behind the one that runs."""
        try:
            future = self._executor.submit(function, argument)
        except BrokenExecutor as error:
            if not self._queue:  # it died with nothing to do
                self._restart()
                return self.submit(function, argument)
            future = Future()
            future.set_exception(error)
        self._queue.append(future)
        return future

    def settle(self, future: Future[Any]) -> None:
        """Be told that a task's outcome was taken; the next has begun."""
        if future in self._queue:
            self._queue.remove(future)
            self._head_since = None
            self._failed_starts = 0

    def running_since(self, future: Future[Any]) -> float | None:
        """Monotonic time at which a task began, as far as the parent has seen it."""
        if not self._queue or future is not self._queue[0] or not self._is_ready():
            return None
        if self._head_since is None:
            self._head_since = time.monotonic()
        return self._head_since

    def _is_ready(self) -> bool:
        return self._ready.done() and self._ready.exception() is None

    def bury(self, future: Future[Any]) -> Burial:
        """Say that the first in the queue ended the worker, and start another."""
        if future not in self._queue:
            return Burial(innocent=[future])
        ready = self._is_ready()
        fallen, exit_code = self._restart()
        if ready:
            return Burial(guilty=fallen[0], innocent=fallen[1:], reason=_death(exit_code))
        self._failed_starts += 1
        if self._failed_starts >= STARTS:
            raise WorkersError(
                "no worker process starts: each dies before its first log; is there memory for as"
                " many as -j says?"
            )
        return Burial(innocent=fallen)

    def end(self, future: Future[Any]) -> Burial:
        """Kill the worker and start another; what was queued behind is done again."""
        self._kill()
        fallen, _ = self._restart()
        return Burial(
            guilty=future if future in fallen else None,  # it may just have come to its end
            innocent=[each for each in fallen if each is not future],
        )

    def _restart(self) -> tuple[list[Future[Any]], int | None]:
        """Start another worker for one that has died; say which tasks fell, and how it ended."""
        self._executor.shutdown(wait=True)
        fallen = [each for each in self._queue if each.exception() is not None]
        self._queue.clear()
        exit_code = self._process.exitcode if self._process is not None else None
        self._start()
        return fallen, exit_code

    def _kill(self) -> None:
        if self._process is not None:
            self._process.kill()

    def close(self, *, now: bool) -> None:
        """Let the worker go."""
        if now:
            self._kill()
        self._executor.shutdown(wait=True, cancel_futures=True)


def _context() -> multiprocessing.context.BaseContext:
    if "forkserver" not in multiprocessing.get_all_start_methods():
        return multiprocessing.get_context("spawn")  # Windows
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([PRELOADED])
    return context


@contextlib.contextmanager
def _single_threaded() -> Iterator[None]:
    """Set what a linear algebra library reads once, when it is first loaded in a worker."""
    before = {name: os.environ.get(name) for name in SINGLE_THREADED}
    os.environ.update(dict.fromkeys(SINGLE_THREADED, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _prepare(memory_bytes: int) -> None:
    """Make a worker process fit for any log: quiet, bounded, and gone when its parent is."""
    import warnings

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    parent = multiprocessing.parent_process()
    if parent is not None:
        threading.Thread(target=_leave_with, args=(parent,), daemon=True).start()
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):  # libraries print about bad bytes; the row of the log says it
        os.dup2(nowhere, stream)
    os.close(nowhere)
    warnings.simplefilter("ignore")
    with contextlib.suppress(OSError), open("/proc/self/oom_score_adj", "w") as file:  # noqa: PTH123
        file.write(FIRST_VICTIMS)
    if memory_bytes:
        bound_memory(memory_bytes)


def _leave_with(parent: multiprocessing.process.BaseProcess) -> None:
    """End this worker when its parent has ended, even by kill -9."""
    parent.join()
    os._exit(1)


def bound_memory(memory_bytes: int) -> None:
    """Let this process ask for so much memory of its own and no more; a MemoryError tells.

    Data, not address space: a mapped log is not memory that anybody lacks.
    """
    try:
        import resource
    except ImportError:  # Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_DATA)
    limit = memory_bytes if hard == resource.RLIM_INFINITY else min(memory_bytes, hard)
    with contextlib.suppress(OSError, ValueError):  # systems that do not know it
        resource.setrlimit(resource.RLIMIT_DATA, (limit, hard))


def machine_memory_bytes() -> int:
    """Memory of this machine or of the container it is; 0 where it cannot be told."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, OSError, ValueError):
        return 0
    try:
        with open("/sys/fs/cgroup/memory.max") as file:  # noqa: PTH123
            memory = min(memory, int(file.read()))
    except (OSError, ValueError):
        pass
    return memory


def _death(exit_code: int | None) -> str:
    if exit_code is None:
        return "the worker died"
    if exit_code < 0:
        try:
            name = signal.Signals(-exit_code).name
        except ValueError:
            name = f"signal {-exit_code}"
        hint = "; out of memory, or killed by hand" if name == "SIGKILL" else ""
        return f"the worker was ended by {name}{hint}"
    return f"the worker ended itself, exit code {exit_code}"


def met_death(future: Future[Any]) -> bool:
    """Tell the death of a worker from an outcome of the task."""
    if future.cancelled():
        return True
    error = future.exception()
    if isinstance(error, BrokenExecutor):
        return True
    distributed = sys.modules.get("distributed")
    return distributed is not None and isinstance(
        error, (distributed.KilledWorker, CancelledError, distributed.client.FutureCancelledError)
    )
