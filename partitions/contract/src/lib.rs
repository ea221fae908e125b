//! The contract between executive and partition: control page, environment, exit codes.
