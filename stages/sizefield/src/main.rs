//! The `sizefield` program.
fn main() {}
