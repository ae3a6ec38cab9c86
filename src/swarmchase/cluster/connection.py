"""A connection to a Ray cluster, or to a small one started on this machine for as long as it is needed."""

import contextlib
import inspect
import ipaddress
import os
import socket
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ..errors import InputError, WorkerDiedError
from ..processes.stop_request import kept_handlers
from . import software
from .software import installed, require_same_software

LOCAL = "local"
"""The address that starts a cluster on this machine."""
LOCAL_OBJECT_STORE_BYTES = 200_000_000
"""Gradients and parameters on their way; what does not fit waits on disk."""
TOKEN_FILE = Path("~/.ray/auth_token")
"""The secret that all machines of a cluster share: ``ray get-auth-token --generate``."""
NO_TOKEN = (
    "The cluster at {address} has no token: whoever reaches its ports can run any program on its machines. "
    "ray get-auth-token --generate makes one (docs/cluster.md)."
)
REACH_LIMIT_S = 5.0
"""For a machine to take a connection."""
HTTP2_PREFACE = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
SETTINGS_TYPE = 4
FRAME_HEADER_BYTES = 9
EMPTY_SETTINGS = bytes([0, 0, 0, SETTINGS_TYPE, 0, 0, 0, 0, 0])
PROBE_LIMIT_S = 60.0
"""For a node to say what is installed there: it starts a Python process first."""

Tell = Callable[[str], None]
"""One line for people."""


@dataclass(frozen=True)
class Cluster:
    """A cluster that this process is connected to."""

    ray: Any
    """The module."""
    home: str
    """The node of this process, where its files are."""

    def node_names(self) -> dict[str, str]:
        """Every node that is alive, by its id: address and host name."""
        return {
            node["NodeID"]: f"{node['NodeManagerAddress']} ({node['NodeManagerHostname']})"
            for node in self.ray.nodes()
            if node["Alive"]
        }

    def num_cpus(self) -> int:
        """CPUs of all nodes."""
        return int(self.ray.cluster_resources().get("CPU", 0))

    def shown_resources(self) -> str:
        """Nodes and CPUs, for people."""
        free = int(self.ray.available_resources().get("CPU", 0))
        return f"the cluster has {len(self.node_names())} nodes with {self.num_cpus()} CPUs, {free} of them free"

    def require_same_software(self, node_names: dict[str, str]) -> None:
        """Ask nodes what is installed there. One that is gone, which the cluster notices late, is passed over.

        Raises:
            InputError: it is not what this process runs, or a node does not answer.
        """
        here = installed()
        # Unwrapped: a type checker's wrapping, which tests have, cannot be sent.
        task = self.ray.remote(num_cpus=0, max_retries=0)(inspect.unwrap(installed))
        answers = {node_id: task.options(scheduling_strategy=at_node(node_id)).remote() for node_id in node_names}
        for node_id, answer in answers.items():
            name = node_names[node_id]
            try:
                require_same_software(name, self.ray.get(answer, timeout=PROBE_LIMIT_S), here)
            except self.ray.exceptions.GetTimeoutError as error:
                raise InputError(
                    f"node {name} has not answered within {PROBE_LIMIT_S:g} s: see `ray status`"
                ) from error
            except self.ray.exceptions.RayError as error:
                if node_id not in self.node_names():
                    continue
                raise InputError(f"node {name} cannot run a task: {first_line(error)}") from error


def at_node(node_id: str) -> Any:
    """The scheduling strategy for this node and no other."""
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    return NodeAffinitySchedulingStrategy(node_id, soft=False)


def first_line(error: BaseException) -> str:
    """What an error says, in one line."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    return lines[0] if lines else type(error).__name__


def own_error(who: str, error: Any) -> Exception:
    """The error that an actor or task raised (Ray's ``RayTaskError``), as the command line tells it."""
    if isinstance(error.cause, InputError):
        return error.cause
    return WorkerDiedError(f"{who} ended with an error:\n{error}")


def ray_module() -> Any:
    """Ray, told to keep to itself.

    Raises:
        InputError: it is not installed.
    """
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    if _has_token():
        # A cluster whose machines have a token wants it; `ray start` looks for it unasked, Ray's Python does not.
        os.environ.setdefault("RAY_AUTH_MODE", "token")
    try:
        with kept_handlers():  # Ray's would end this process at once
            import ray
    except ModuleNotFoundError as error:
        raise InputError("a cluster needs Ray, which is not installed: pip install 'swarmchase[cluster]'") from error
    # A node that lacks this package, or has another, must still be able to say so.
    ray.cloudpickle.register_pickle_by_value(software)
    return ray


def _has_token() -> bool:
    return bool({"RAY_AUTH_TOKEN", "RAY_AUTH_TOKEN_PATH"} & os.environ.keys()) or TOKEN_FILE.expanduser().exists()


@contextlib.contextmanager
def connected(address: str, local_cpus: int, tell: Tell = lambda _line: None) -> Iterator[Cluster]:
    """The cluster at ``address`` (HOST:PORT of its head), or one of ``local_cpus`` CPUs on this machine for ``local``,
    which no other machine can reach.

    This machine must be one of its nodes. Whatever runs there for this process ends with the block.

    Args:
        tell: is given a line for people where a cluster is joined that keeps nobody out.

    Raises:
        InputError: no Ray, nobody at the address, another version of Ray or Python there, no CPUs, a node without
            this package or with other versions.
    """
    if address != LOCAL:
        _require_head(address)
    ray = ray_module()
    if ray.is_initialized():
        raise InputError("this process is connected to a Ray cluster already: leave it first (ray.shutdown())")
    with _notices_on_standard_error():
        _connect(ray, address, local_cpus)
        try:
            cluster = Cluster(ray, ray.get_runtime_context().get_node_id())
            if cluster.num_cpus() < 1:
                raise InputError(f"the cluster at {address} has no CPUs: start its nodes with `ray start --num-cpus N`")
            if address == LOCAL:
                _require_loopback(ray)
            else:
                if not _has_token():
                    tell(NO_TOKEN.format(address=address))
                cluster.require_same_software(cluster.node_names())
            yield cluster
        finally:
            ray.shutdown()


@contextlib.contextmanager
def _on_loopback() -> Iterator[None]:
    """Ray binds to all interfaces, also where ``_node_ip_address`` is 127.0.0.1, unless it believes that there are no
    clusters of several machines: as on macOS and Windows, and inside this block.
    """
    from ray._private import ray_constants

    before = ray_constants.ENABLE_RAY_CLUSTER
    ray_constants.ENABLE_RAY_CLUSTER = False
    try:
        yield
    finally:
        ray_constants.ENABLE_RAY_CLUSTER = before


def _require_loopback(ray: Any) -> None:
    """What the block above relies on is not promised to be in every version of Ray.

    Raises:
        InputError: other machines could reach this cluster.
    """
    address = ray.nodes()[0]["NodeManagerAddress"]
    if not ipaddress.ip_address(address).is_loopback:
        raise InputError(f"Ray {ray.__version__} cannot be kept to this machine: it listens at {address}")


@contextlib.contextmanager
def _notices_on_standard_error() -> Iterator[None]:
    """Ray tells of nodes and processes that died on standard output, where a command's result stands (``--json``), and
    has no option for it: inside this block it tells of them on standard error.
    """
    from ray._private import worker

    before = worker.print_to_stdstream

    def on_standard_error(data: dict[str, Any], *more: Any, **options: Any) -> None:
        before({**data, "is_err": True}, *more, **options)

    worker.print_to_stdstream = on_standard_error
    try:
        yield
    finally:
        worker.print_to_stdstream = before


def _connect(ray: Any, address: str, local_cpus: int) -> None:
    options: dict[str, Any] = {"log_to_driver": False, "logging_level": "error", "configure_logging": True}
    if address == LOCAL:
        options |= {
            "num_cpus": local_cpus,
            "object_store_memory": LOCAL_OBJECT_STORE_BYTES,
            "include_dashboard": False,
        }
    try:
        loopback = _on_loopback() if address == LOCAL else contextlib.nullcontext()
        with kept_handlers(), warnings.catch_warnings(), loopback:
            warnings.simplefilter("ignore")  # Ray's own, of what it will change one day
            ray.init(address=address, **options)
    except Exception as error:  # of several kinds, and of others in other versions of Ray
        raise InputError(f"cannot join the Ray cluster at {address}: {_reason(error)}") from error


def _reason(error: Exception) -> str:
    text = " ".join(str(error).split())
    if "ersion mismatch" in text:
        return f"{text}; install the same versions on all machines"
    if "Failed to connect" in text or "uthenticat" in text:
        return f"{text}; has this machine the token of its head ({TOKEN_FILE})?"
    if "node_ip_address" in text or "Raylet" in text or "raylet" in text:
        return f"this machine is none of its nodes: `ray start --address HOST:PORT` here first ({text})"
    return text


def _require_head(address: str) -> None:
    """Ray itself would try for minutes.

    Raises:
        InputError: not HOST:PORT, nobody takes a connection there, or what does is no head of a cluster.
    """
    host, colon, port = address.rpartition(":")
    if not (colon and host and port.isascii() and port.isdigit() and 0 < int(port) < 2**16):
        raise InputError(f"cluster address {address!r} is refused: allowed is HOST:PORT of its head, or {LOCAL}")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), timeout=REACH_LIMIT_S) as connection:
            is_head = os.environ.get("RAY_USE_TLS") == "1" or _speaks_http2(connection)
    except OSError as error:
        raise InputError(
            f"nobody answers at the cluster address {address} ({error.strerror or error}): is `ray start --head "
            f"--port {port}` running there?"
        ) from error
    if not is_head:
        raise InputError(f"what answers at the cluster address {address} is not the head of a Ray cluster")


def _speaks_http2(connection: socket.socket) -> bool:
    """Whether it greets as the head's gRPC server does: with a SETTINGS frame (RFC 9113, Sections 3.4 and 6.5)."""
    connection.sendall(HTTP2_PREFACE + EMPTY_SETTINGS)
    greeting = b""
    while len(greeting) < FRAME_HEADER_BYTES:
        received = connection.recv(FRAME_HEADER_BYTES - len(greeting))
        if not received:
            return False
        greeting += received
    return greeting[3] == SETTINGS_TYPE
