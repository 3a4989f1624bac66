//! The `particles` program.
fn main() {}
