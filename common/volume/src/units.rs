//! Units of length in volume headers.

/// Returns the length of a unit in mm, or `None` if `name` is not a unit of length.
pub(crate) fn millimetres(name: &str) -> Option<f64> {
    let name = name.trim().to_lowercase().replace("metre", "meter");
    // accept the plurals of words but not of symbols, because `ms` means milliseconds
    let stem = if name.chars().count() > 3 { name.trim_end_matches('s') } else { &name };
    Some(match stem {
        "mm" | "millimeter" => 1.0,
        "cm" | "centimeter" => 10.0,
        "dm" | "decimeter" => 100.0,
        "m" | "meter" => 1000.0,
        // the micro sign is U+00B5 or U+03BC; decoding Latin-1 as UTF-8 gives U+FFFD
        "um" | "\u{b5}m" | "\u{3bc}m" | "\u{fffd}m" | "micron" | "micrometer" => 1e-3,
        "nm" | "nanometer" => 1e-6,
        "in" | "inch" | "inche" => 25.4,
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::millimetres;

    #[test]
    fn lengths_are_known_by_symbol_and_by_word() {
        for (length, names) in [
            (1.0, "mm|MM|millimeter|Millimetres"),
            (10.0, "cm|centimeters"),
            (1000.0, "m|meter|metres"),
            (1e-3, "um|\u{b5}m|\u{3bc}m|micron|microns|micrometers|Micrometre"),
            (1e-6, "nm|nanometers"),
            (25.4, "in|inch|inches"),
        ] {
            names.split('|').for_each(|name| assert_eq!(millimetres(name), Some(length), "{name}"));
        }
        assert!(["s", "ms", "", "pixel", "furlong"].iter().all(|name| millimetres(name).is_none()));
    }
}
