//! The function that flies: specific-acceleration loops, roll-rate loop and guidance.
