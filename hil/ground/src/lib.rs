//! The ground station: way-points, autopilot, telemetry.
