"""AR.Drone navdata: packets, pcap, AT commands."""
