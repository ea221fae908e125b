//! The function that turns raw analogue values into inertial, magnetic and pressure measurements.
