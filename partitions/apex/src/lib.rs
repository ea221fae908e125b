//! What a partition links: windows, ports, time, health.
