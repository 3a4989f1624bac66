//! phantom program
fn main() {}
