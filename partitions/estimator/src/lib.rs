//! The function that estimates position, velocity and attitude.
