//! The function that turns a receiver's raw fixes into position and velocity.
