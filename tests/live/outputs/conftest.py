"""The chase that tests of outputs and exports look at is flown once."""

import pytest

pytest.importorskip("pymavlink", reason="the live system needs: pip install 'swarmchase[live]'")
pytest.importorskip("mcap", reason="the log needs: pip install 'swarmchase[live]'")
pytest.importorskip("paho.mqtt.client", reason="output mqtt needs: pip install 'swarmchase[mqtt]'")

from live.outputs.shown_chase import Shown, shown_chase


@pytest.fixture(scope="session")
def shown(tmp_path_factory: pytest.TempPathFactory) -> Shown:
    return shown_chase(tmp_path_factory.mktemp("outputs"))
