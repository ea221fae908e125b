//! Words to standard output and standard error that can not end a verb: the macros of the standard library panic where nobody reads.

/// As that of the standard library, but in one write, as others write to the same standard error, and a line that nobody reads any more
/// (`| head`, a closed terminal) is dropped: it is no reason to end a flight.
#[macro_export]
macro_rules! eprintln {
    ($($words:tt)*) => {{
        let _ = ::std::io::Write::write_all(&mut ::std::io::stderr(), format!("{}\n", format_args!($($words)*)).as_bytes());
    }};
}

/// As above, on standard output: see [`printed`](crate::printed).
#[macro_export]
macro_rules! print {
    ($($words:tt)*) => {{
        let _ = ::std::io::Write::write_fmt(&mut $crate::printed::Printed, format_args!($($words)*));
    }};
}

/// As above, a line.
#[macro_export]
macro_rules! println {
    () => { $crate::print!("\n") };
    ($($words:tt)*) => { $crate::print!("{}\n", format_args!($($words)*)) };
}
