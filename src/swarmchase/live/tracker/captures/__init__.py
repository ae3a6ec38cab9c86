"""What captures of packets hold: their containers, radiotap headers, 802.11 frames, Remote ID."""
