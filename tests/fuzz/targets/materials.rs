#![no_main]

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| isoparticles_tests::readers::Reader::named("materials").feed(bytes));
