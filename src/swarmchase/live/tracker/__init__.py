"""The tracker agent, its RSSI sources and its vehicles. It needs neither torch nor numpy."""
