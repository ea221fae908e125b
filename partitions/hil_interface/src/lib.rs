//! The function that exchanges sensors and actuators with a simulator over UDP.
