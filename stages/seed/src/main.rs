//! The `seed` program.
fn main() {}
