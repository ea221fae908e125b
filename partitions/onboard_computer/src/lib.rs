//! The function that reports the status and the supply voltages of the whole system.
