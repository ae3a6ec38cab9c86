"""A Ray cluster of several nodes on this machine, for tests: add a node, take one away, end a process in it."""

import contextlib
import ipaddress
import os
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from swarmchase.cluster.connection import ray_module

WAIT_S = 90
OBJECT_STORE_BYTES = 120_000_000
SYSTEM = {"health_check_initial_delay_ms": 1000, "health_check_period_ms": 1000, "health_check_failure_threshold": 5}
"""A node that is gone is missed after some seconds, not after a quarter of a minute."""


class Nodes:
    """The nodes of a cluster; the first is its head, where the tests' process is."""

    def __init__(self, num_cpus: float) -> None:
        ray_module()
        from ray.cluster_utils import Cluster

        arguments = _arguments(num_cpus) | {"_system_config": SYSTEM}
        self._cluster = Cluster(initialize_head=True, shutdown_at_exit=True, head_node_args=arguments)
        self.head = self._cluster.head_node
        self.address: str = self._cluster.address

    def add(self, num_cpus: float, **variables: str) -> Any:
        """A further node, whose processes have these environment variables."""
        return self._cluster.add_node(**_arguments(num_cpus), env_vars=variables or None)

    def remove(self, node: Any) -> None:
        """The node is gone at once, with all of its processes."""
        self._cluster.remove_node(node, allow_graceful=False)

    def settle(self) -> None:
        """Wait until the head has noticed which nodes have gone: it takes some seconds."""
        self._cluster.wait_for_nodes(WAIT_S)

    @contextlib.contextmanager
    def with_node(self, num_cpus: float) -> Iterator[Any]:
        """A further node as long as the block lasts; it says that it goes."""
        node = self.add(num_cpus)
        try:
            yield node
        finally:
            self._cluster.remove_node(node)

    def shut_down(self) -> None:
        """End all nodes."""
        self._cluster.shutdown()


def _arguments(num_cpus: float) -> dict[str, Any]:
    return {"num_cpus": num_cpus, "object_store_memory": OBJECT_STORE_BYTES, "include_dashboard": False}


@contextlib.contextmanager
def nodes(num_cpus: float) -> Iterator[Nodes]:
    """A cluster whose head has so many CPUs."""
    cluster = Nodes(num_cpus)
    try:
        yield cluster
    finally:
        cluster.shut_down()


def processes_at(node: Any, name: str) -> list[int]:
    """The processes at a node that Ray shows under a name, which is the class of an actor."""
    raylet = node.all_processes["raylet"][0].process.pid
    return [
        number
        for number, (parent, words) in processes().items()
        if parent == raylet and words.startswith(f"ray::{name}")
    ]


def processes() -> dict[int, tuple[int, str]]:
    """Parent and command line of every process."""
    found = {}
    for entry in Path("/proc").glob("[0-9]*"):
        with contextlib.suppress(OSError, ValueError, IndexError):
            words = (entry / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")
            found[int(entry.name)] = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1]), words
    return found


def listening_addresses(root: int) -> set[str]:
    """Where this process and all of its descendants take TCP connections."""
    tree = {root}
    while more := {number for number, (parent, _) in processes().items() if parent in tree} - tree:
        tree |= more
    sockets = set()
    for entry in (entry for number in tree for entry in Path("/proc").glob(f"{number}/fd/*")):
        with contextlib.suppress(OSError):
            sockets.add(str(entry.readlink()))
    found = set()
    for table in ("tcp", "tcp6"):
        for row in Path(f"/proc/net/{table}").read_text().splitlines()[1:]:
            address, state, inode = (row.split()[column] for column in (1, 3, 9))
            if state == "0A" and f"socket:[{inode}]" in sockets:
                raw = bytes.fromhex(address.partition(":")[0])
                words = b"".join(raw[place : place + 4][::-1] for place in range(0, len(raw), 4))
                one = ipaddress.ip_address(words)
                found.add(str(getattr(one, "ipv4_mapped", None) or one))
    return found


def kill_one(node: Any, name: str) -> None:
    """End one of these processes by force."""
    os.kill(processes_at(node, name)[0], signal.SIGKILL)


def wait_until(condition: Callable[[], bool], what: str) -> None:
    """Wait for it, not for ever."""
    end_s = time.monotonic() + WAIT_S
    while not condition():
        assert time.monotonic() < end_s, f"waited {WAIT_S} s in vain: {what}"
        time.sleep(0.05)
