"""Tasks on the workers of a Dask scheduler, which needs the extra `dask`."""

from collections.abc import Callable, Iterable, Iterator
from itertools import islice
from typing import TYPE_CHECKING, Any, TypeVar

from .errors import InputError


if TYPE_CHECKING:
    from distributed import Client


_AHEAD = 4  # tasks in the queue for each thread of a worker: a scheduler bears thousands, not millions
_PATIENCE = 30.0  # s for the scheduler to answer
_WITH_PORTS = ("tcp", "tls", "ws", "wss")  # addresses of a host and its port
Item = TypeVar("Item")


def farmed(task: Callable[[Item], Any], items: Iterable[Item], scheduler: str) -> Iterator[tuple[Item, Any]]:
    """Runs `task` on each of the items on the workers of the scheduler at an address; yields (item, what it gave) as
    they end. A task whose worker dies is run again by another.

    The workers need this package. JAX is set up in them as `runtime.configure` does before `task` is unpacked. What a
    task gives is held no longer than until it is yielded: it should be small, and the result go to a store.

    Raises `InputError` without the extra `dask`, and where no scheduler answers.
    """
    client = _reached(scheduler)
    import cloudpickle
    from distributed import as_completed

    packed, rest = cloudpickle.dumps(task), iter(items)
    with client:
        threads = sum(client.nthreads().values())
        begun = {}

        def begin(item: Item) -> Any:
            future = client.submit(_run, packed, item, pure=False)
            begun[future.key] = item
            return future

        first = [begin(item) for item in islice(rest, _AHEAD * max(1, threads))]
        queue = as_completed(first, loop=client.loop)
        for future in queue:
            item, found = begun.pop(future.key), future.result()
            future.release()
            for following in islice(rest, 1):
                queue.add(begin(following))
            yield item, found


def require_scheduler(scheduler: str) -> None:
    """Raises `InputError` as `farmed` does, before anything is begun for the workers of a scheduler."""
    _reached(scheduler).close()


def _reached(scheduler: str) -> "Client":
    try:
        from distributed import Client
        from distributed.comm.addressing import parse_address, parse_host_port
    except ImportError as error:
        raise InputError("Argument `dask` needs the package distributed; install `memsgyro_jax[dask]`.") from error
    try:
        # A client of what is no address waits for long, and then ends in a traceback beside the refusal.
        if parse_address(scheduler)[0] in _WITH_PORTS:
            parse_host_port(parse_address(scheduler)[1])
        return Client(scheduler, timeout=_PATIENCE, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise InputError(
            "Argument `dask` must be the address of a scheduler, as tcp://host:8786 of `dask scheduler`, but at "
            f"{scheduler} none answers."
        ) from error


def _run(packed: bytes, item: Any) -> Any:
    """In a worker. The task comes packed, because unpacking it makes arrays of JAX, which must be set up before."""
    import cloudpickle

    from .runtime import configure

    configure()
    return cloudpickle.loads(packed)(item)
