//! The services of ARINC 653 Part 1 for partitions in C and C++: the functions that `include/apex.h` declares.
//!
//! Responsible for: names, types and layouts of the standard's C interface, and what may be wrong with a pointer. What a service does is
//! decided in `bateleur-processes`. It must never let a panic or an unwinding stack reach a caller: a panic in here ends the program.

mod services;
pub mod types;
