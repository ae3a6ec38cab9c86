"""A level, and whose it is, in a line of text as common sketches for ESP32 and ESP8266 print it.

-61                                                       Serial.println(WiFi.RSSI())
RSSI: -61 dBm                                             and its like: RSSI=-61, Signal strength (RSSI): -61
1: network (-61)*                                         Arduino's WiFiScan
 1 | network                          | -61 |  6 | WPA2   WiFiScan since version 2.0.3 of the board's package
PACKET TYPE=MGMT, CHAN=06, RSSI=-61, ADDR1=..., ADDR2=... the ESP32 sniffers; ADDR2 transmits
Advertised Device: Name: x, Address: 02:..., rssi: -61    BLE scans
CSI_DATA,0,02:...,-61,11,...                              Espressif's esp-csi
"""

import re
from dataclasses import dataclass

_MAC = r"(?:[0-9A-Fa-f]{2}:){5}[0-9A-Fa-f]{2}"
_NUMBER = r"[-+]?\d{1,3}(?:\.\d{1,3})?"
_ALONE = re.compile(r"(-\d{1,3}(?:\.\d{1,3})?)(?:\s*dBm)?", re.IGNORECASE)
_NAMED = re.compile(
    rf"(?:\bRSSI\b|\bsignal(?:\s+strength)?\b)(?:\s*\(\w+\))?[\"']?\s*[:=]?\s*({_NUMBER})(?![\d.])", re.IGNORECASE
)
_SCAN = re.compile(rf"\s*\d+\s*: (.*) \(({_NUMBER})\).*")
_SCAN_TABLE = re.compile(rf"\s*\d+ \| (.*?) *\| *({_NUMBER}) \| *\d+ \|.*")
_CSI = re.compile(rf"CSI_DATA,[^,]*,({_MAC}),({_NUMBER}),.*")
_TRANSMITTER = re.compile(rf"\bADDR2=({_MAC})")
_ANY_MAC = re.compile(rf"(?<![0-9A-Fa-f:]){_MAC}(?![0-9A-Fa-f:])")


@dataclass(frozen=True)
class Heard:
    """What a line says."""

    rssi_dbm: float
    mac: str | None = None
    """In lower case."""
    name: str | None = None
    """Of a network."""


def heard_in(line: str) -> Heard | None:
    """What a line of text says; None where no level is in it. Never raises."""
    line = line.strip()
    if found := _ALONE.fullmatch(line):
        return Heard(float(found[1]))
    if found := _CSI.fullmatch(line):
        return Heard(float(found[2]), found[1].lower())
    if found := _SCAN_TABLE.fullmatch(line) or _SCAN.fullmatch(line):
        return Heard(float(found[2]), name=found[1].strip() or None)
    if found := _NAMED.search(line):
        mac = _TRANSMITTER.search(line) or _ANY_MAC.search(line)
        return Heard(float(found[1]), None if mac is None else mac[mac.lastindex or 0].lower())
    return None
