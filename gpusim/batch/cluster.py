"""Where a batch is done: a caller's cluster, a scheduler's, or processes of this machine.

Workers of this machine are forked from one process that has imported what they need: on Linux, and
else started anew. It begins before the sweep is read, so that both import at once.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from multiprocessing import forkserver, set_forkserver_preload
from typing import TYPE_CHECKING

from gpusim.errors import UserError

if TYPE_CHECKING:
    from distributed import Client

THREADS = 2  # tasks at a time of a worker: one on its device, one that writes files
FORKS = sys.platform == "linux"  # elsewhere drivers and system libraries may not outlive a fork
# What Dask gives a worker that it starts anew (distributed.nanny.pre-spawn-environ): processes of
# one thread, whose allocator gives memory back.
ENVIRONMENT = {
    "MALLOC_TRIM_THRESHOLD_": "65536",
    "OMP_NUM_THREADS": "1",
    "MKL_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
}
# Work itself, the driver's library, Dask's processes, and the command: a worker's main module.
IMPORTED = [
    "gpusim.batch.work",
    "wgpu.backends.wgpu_native",
    "distributed",
    "distributed.nanny",
    "gpusim.cli",
]


def prepare_workers() -> None:
    """Begin to import what workers of this machine need, in the process they are forked from."""
    if not FORKS:
        return
    set_forkserver_preload(IMPORTED)
    before = {name: os.environ.get(name) for name in ENVIRONMENT}
    os.environ.update(ENVIRONMENT)
    try:
        forkserver.ensure_running()
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


@contextmanager
def connected(workers: int, scheduler: str | None, client: Client | None) -> Iterator[Client]:
    """Yield the caller's cluster, one at an address, or one of this machine's processes.

    Raises
    ------
    UserError
        The scheduler does not answer.
    """
    if client is not None:
        yield client
        return
    import dask
    import distributed.utils
    from distributed import Client, LocalCluster

    # A light lies where its first frames went: moving tasks about would bring it elsewhere too.
    settings = {
        "distributed.scheduler.work-stealing": False,
        "distributed.worker.daemon": True,
        "distributed.worker.multiprocessing-method": "forkserver" if FORKS else "spawn",
        "distributed.admin.log-format": "",
    }
    with dask.config.set(settings):
        if scheduler is not None:
            try:
                with Client(scheduler, timeout=10) as made:
                    yield made
            except (OSError, TimeoutError) as error:
                raise UserError(
                    "the scheduler does not answer",
                    field="--scheduler",
                    value=scheduler,
                    allowed="the address of a running dask scheduler: tcp://host:8786",
                ) from error
            return
        prepare_workers()
        # Else Dask names what is imported for workers, and imports that here: pandas, 0.25 s.
        distributed.utils._forkserver_preload_set = True
        with (
            LocalCluster(
                n_workers=workers,
                threads_per_worker=THREADS,
                processes=True,
                host="127.0.0.1",
                dashboard_address=None,
                memory_limit=0,
                silence_logs="CRITICAL",  # a heartbeat that meets the end is logged as an error
                env=dict(os.environ),  # that of now: the process they are forked from began before
            ) as cluster,
            Client(cluster) as made,
        ):
            yield made
