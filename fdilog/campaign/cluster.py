"""A whole Dask cluster as one wide lane."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import Any

import fdilog
from fdilog.campaign.lanes import Burial, WorkersError

CONNECT_S = 15.0


class ClusterLane:
    """All workers of a Dask cluster, through the executor of `dask.distributed`.

    A task counts as begun when it is submitted: there is never more than one for each thread.
    """

    def __init__(self, address: str) -> None:
        try:
            import distributed
        except ImportError:
            raise WorkersError(
                "--cluster needs dask.distributed: pip install 'fdilog[cluster]'"
            ) from None
        connect: Any = distributed.Client
        try:
            self._client = connect(address, timeout=CONNECT_S, set_as_default=False)
        except (OSError, ValueError, TimeoutError) as error:
            raise WorkersError(f"{address}: no Dask scheduler answers: {error}") from None
        self.address = address
        self._executor = self._client.get_executor(pure=False)
        self._began: dict[Future[Any], tuple[float, str]] = {}
        self._number = 0
        self._check()

    def _check(self) -> None:
        threads = self._client.nthreads()
        if not threads:
            self._client.close()
            raise WorkersError(f"{self.address}: the cluster has no workers")
        self.room = sum(threads.values())
        for worker, version in self._client.run(_worker_version).items():
            if version != fdilog.__version__:
                self._client.close()
                raise WorkersError(
                    f"{self.address}: worker {worker} has fdilog {version}, this is"
                    f" {fdilog.__version__}; install the same everywhere"
                )

    def submit(self, function: Callable[[Any], Any], argument: Any) -> Future[Any]:
        """Begin a task on some worker."""
        self._number += 1
        key = f"fdilog-{os.getpid()}-{id(self)}-{self._number}"
        future: Future[Any] = self._executor.submit(function, argument, key=key)
        self._began[future] = (time.monotonic(), key)
        return future

    def settle(self, future: Future[Any]) -> None:
        """Be told that a task's outcome was taken."""
        self._began.pop(future, None)

    def running_since(self, future: Future[Any]) -> float | None:
        """Monotonic time at which a task was submitted."""
        return self._began[future][0]

    def bury(self, future: Future[Any]) -> Burial:
        """Say that nobody knows: the scheduler gave up a task after several dead workers.

        They may have died of another task; alone, it is guilty.
        """
        if self._client.status != "running":
            raise WorkersError(f"{self.address}: the scheduler is gone")
        del self._began[future]
        return Burial(unclear=[future], reason="every Dask worker that tried it died")

    def end(self, future: Future[Any]) -> Burial:
        """Cancel a task and restart the worker that it holds up; the scheduler moves the others."""
        _, key = self._began.pop(future)
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
        self._client.close()


def _worker_version() -> str:
    return fdilog.__version__
