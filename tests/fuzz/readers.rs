//! Fuzzes the file reader whose name is in the environment variable `READER`.

#![no_main]

use isoparticles_tests::readers::{Feeder, Reader};
use libfuzzer_sys::fuzz_target;
use std::sync::LazyLock;

static FEEDER: LazyLock<Feeder> = LazyLock::new(|| {
    let name = std::env::var("READER").expect("READER names the reader, as in tests/src/readers.rs");
    Feeder::new(Reader::named(&name))
});

fuzz_target!(init: LazyLock::force(&FEEDER), |bytes: &[u8]| FEEDER.feed(bytes));
