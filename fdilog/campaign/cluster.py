"""A whole Dask cluster as one wide lane."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import distributed

import fdilog
from fdilog.campaign.lanes import Burial, WorkersError

CONNECT_S = 15.0
ASK_S = 1.0
"""How often the scheduler is asked what its workers are at; they tell it about as often."""
WARM = "fdilog-warm"


class _Warm(distributed.WorkerPlugin):  # type: ignore[misc, unused-ignore]
    """Imports what an analysis needs when a worker starts, so that no log's time pays for it."""

    def setup(self, worker: Any) -> None:  # noqa: ARG002
        import fdilog.campaign.warm  # noqa: F401


class ClusterLane:
    """All workers of a Dask cluster, through the executor of `dask.distributed`.

    Which memory a worker may take is the cluster's own setting; there is never more than one task
    for each of its threads.
    """

    def __init__(self, address: str) -> None:
        self.address = address
        # Most of the client has no types.
        connect: Any = distributed.Client
        try:
            self._client = connect(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise WorkersError(f"{address}: no Dask scheduler answers: {error}") from None
        self._executor = self._client.get_executor(pure=False)
        self._keys: dict[Future[Any], str] = {}
        self._number = 0
        self._asked = 0.0
        self._since: dict[str, float] = {}
        try:
            self._check()
        except BaseException:
            self._client.close()
            raise
        self._client.register_plugin(_Warm(), name=WARM)

    def _check(self) -> None:
        threads = self._client.nthreads()
        if not threads:
            raise WorkersError(f"{self.address}: the cluster has no workers")
        self.room = sum(threads.values())
        for worker, version in self._client.run(_version).items():
            if version != fdilog.__version__:
                raise WorkersError(
                    f"{self.address}: worker {worker} has fdilog {version}, this is"
                    f" {fdilog.__version__}; install the same everywhere"
                )

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Begin a task on some worker."""
        self._number += 1
        key = f"fdilog-{os.getpid()}-{time.time_ns()}-{self._number}"
        future: Future[Any] = self._executor.submit(function, argument, key=key)
        self._keys[future] = key
        return future

    def settle(self, future: Future[Any]) -> None:
        """Be told that a task's outcome was taken."""
        self._keys.pop(future, None)

    def running_since(self, future: Future[Any]) -> float | None:
        """Monotonic time at which a worker began a task, by what it told the scheduler."""
        now = time.monotonic()
        if now - self._asked >= ASK_S and self._client.status == "running":
            self._asked = now
            executing: dict[str, float] = self._client.run_on_scheduler(_executing)
            self._since = {key: now - seconds for key, seconds in executing.items()}
        return self._since.get(self._keys[future])

    def bury(self, future: Future[Any]) -> Burial:
        """Say that nobody knows: the scheduler gave up a task after several dead workers.

        They may have died of another task; alone, it is guilty.
        """
        if self._client.status != "running":
            raise WorkersError(f"{self.address}: the scheduler is gone")
        del self._keys[future]
        return Burial(unclear=[future], reason="every Dask worker that tried it died")

    def end(self, future: Future[Any]) -> Burial:
        """Cancel a task and restart the worker that it holds up; the scheduler moves the others."""
        key = self._keys.pop(future)
        holding = [
            worker
            for worker, keys in self._client.processing().items()
            if any(str(each) == key for each in keys)
        ]
        future.cancel()
        if holding:
            self._client.restart_workers(holding, timeout=CONNECT_S, raise_for_error=False)
        return Burial(guilty=future)

    def close(self, *, now: bool) -> None:
        """Leave the cluster as it was found."""
        self._executor.shutdown(wait=not now)
        if self._client.status == "running":
            self._client.unregister_worker_plugin(WARM)
        self._client.close()


def _version() -> str:
    return fdilog.__version__


def _executing(dask_scheduler: Any = None) -> dict[str, float]:
    """Seconds for which each task is being done; runs in the scheduler."""
    return {
        str(task.key): float(seconds)
        for worker in dask_scheduler.workers.values()
        for task, seconds in worker.executing.items()
    }
