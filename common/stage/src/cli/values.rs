//! Parses numeric option values, with errors that state the bounds, and formats lengths.

/// Parses a finite number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    number(text, |x| x > 0.0, "must be finite and above 0")
}

/// Parses a finite number of at least 0.
pub fn not_negative(text: &str) -> Result<f64, String> {
    number(text, |x| x >= 0.0, "must be finite and at least 0")
}

/// Parses a number from 0 to 1.
pub fn share(text: &str) -> Result<f64, String> {
    number(text, |x| (0.0..=1.0).contains(&x), "must be from 0 to 1")
}

/// Parses a finite number above 1.
pub fn above_one(text: &str) -> Result<f64, String> {
    number(text, |x| x > 1.0, "must be finite and above 1")
}

/// Parses a number of bytes above 0. K, M, G and T denote powers of 1024, for example `8G`, `500M`
/// or `1.5GiB`.
pub fn bytes(text: &str) -> Result<u64, String> {
    let must = "must be a number of bytes above 0, such as 8G or 500M";
    let lower = text.trim().to_ascii_lowercase();
    let unit = lower.strip_suffix("ib").or_else(|| lower.strip_suffix('b')).unwrap_or(&lower);
    let digits = unit.trim_end_matches(['k', 'm', 'g', 't']);
    let power = match &unit[digits.len()..] {
        "" => 0,
        "k" => 1,
        "m" => 2,
        "g" => 3,
        "t" => 4,
        _ => return Err(must.into()),
    };
    match digits.trim().parse::<f64>() {
        Ok(x) if x.is_finite() && x * 1024f64.powi(power) >= 1.0 => Ok((x * 1024f64.powi(power)) as u64),
        _ => Err(must.into()),
    }
}

/// Formats a number with up to four significant digits, without trailing zeros. Uses an exponent
/// for absolute values that are below 0.001 or at least 1e7.
pub fn significant(value: f64) -> String {
    let rounded = format!("{value:.3e}").parse().unwrap_or(value);
    if rounded == 0.0 || !rounded.is_finite() || (1e-3..1e7).contains(&rounded.abs()) {
        // adding 0 removes the sign of -0
        format!("{}", rounded + 0.0)
    } else {
        format!("{rounded:e}")
    }
}

/// Formats a position (mm) with up to three decimals. Uses [`significant`] for coordinates below
/// 0.01 in absolute value.
pub fn place(position: [f64; 3]) -> String {
    let coordinate = |x: f64| if x.abs() < 0.01 { significant(x) } else { format!("{}", (1e3 * x).round() / 1e3) };
    format!("({})", position.map(coordinate).join(", "))
}

fn number(text: &str, fits: impl Fn(f64) -> bool, must: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(x) if x.is_finite() && fits(x) => Ok(x),
        Ok(_) => Err(must.into()),
        Err(error) => Err(error.to_string()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn small_lengths_keep_their_digits() {
        assert_eq!([0.0, 2.5, -0.01, 0.0099].map(significant), ["0", "2.5", "-0.01", "0.0099"]);
        assert_eq!([-0.0, 8.22e2, 24_637.5, 0.99999].map(significant), ["0", "822", "24640", "1"]);
        assert_eq!([1.6e-6, 9.9999e6, 1.23456e9].map(significant), ["1.6e-6", "1e7", "1.235e9"]);
        assert_eq!(place([1.6e-6, -2.0, 1234.56789]), "(1.6e-6, -2, 1234.568)");
    }

    #[test]
    fn bounds_are_kept_and_said() {
        assert_eq!(positive("0.5"), Ok(0.5));
        assert_eq!(not_negative("0"), Ok(0.0));
        assert_eq!(share("1"), Ok(1.0));
        assert_eq!(above_one("1.5"), Ok(1.5));
        for wrong in [positive("0"), positive("inf"), not_negative("-1"), share("1.1"), share("NaN"), above_one("1")] {
            assert!(wrong.unwrap_err().starts_with("must be"));
        }
        assert!(positive("one").is_err());
        assert_eq!(["8G", "500 mb", "1.5KiB", "12"].map(bytes), [8 << 30, 500 << 20, 1536, 12].map(Ok));
        for wrong in ["", "G", "0", "-1G", "8GG", "8bb", "8GiBib", "inf", "8X"] {
            assert!(bytes(wrong).is_err(), "{wrong}");
        }
    }
}
