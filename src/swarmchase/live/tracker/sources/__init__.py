"""Where a tracker's RSSI samples come from, all behind one protocol."""

from .json_datagrams import JsonDatagramSource
from .json_records import JsonRecords
from .kismet import KismetSource
from .line_source import LineSource, OpenDescriptor
from .pcap import PcapSource, pcap_rows
from .protocol import CalibratedSource, RssiSource, Sample
from .radio_status import RadioStatusSource, sik_dbm
from .rejected import Rejected
from .replay import ReplaySource, csv_rows, json_rows
from .sample_buffer import SampleBuffer
from .sender_clock import SenderClock
from .simulated import SimulatedSource
from .transmitters import Transmitters

__all__ = [
    "CalibratedSource",
    "JsonDatagramSource",
    "JsonRecords",
    "KismetSource",
    "LineSource",
    "OpenDescriptor",
    "PcapSource",
    "RadioStatusSource",
    "Rejected",
    "ReplaySource",
    "RssiSource",
    "Sample",
    "SampleBuffer",
    "SenderClock",
    "SimulatedSource",
    "Transmitters",
    "csv_rows",
    "json_rows",
    "pcap_rows",
    "sik_dbm",
]
