"""One Ray cluster for all tests of this folder: a head takes long to start."""

from collections.abc import Iterator

import pytest

from ray_nodes import Nodes, nodes


@pytest.fixture(scope="session")
def head() -> Iterator[Nodes]:
    """Without CPUs: each file adds the nodes that it needs, which go with it."""
    with nodes(num_cpus=0) as started:
        yield started
