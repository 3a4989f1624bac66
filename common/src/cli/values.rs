//! Parsers of the numbers that options take, with the bounds said in words.

/// A finite number above 0.
pub fn positive(text: &str) -> Result<f64, String> {
    number(text, |x| x > 0.0, "must be finite and above 0")
}

/// A finite number, 0 or above.
pub fn not_negative(text: &str) -> Result<f64, String> {
    number(text, |x| x >= 0.0, "must be finite and not below 0")
}

/// A number from 0 to 1.
pub fn share(text: &str) -> Result<f64, String> {
    number(text, |x| (0.0..=1.0).contains(&x), "must be from 0 to 1")
}

/// A finite number above 1.
pub fn above_one(text: &str) -> Result<f64, String> {
    number(text, |x| x > 1.0, "must be finite and above 1")
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
    fn bounds_are_kept_and_said() {
        assert_eq!(positive("0.5"), Ok(0.5));
        assert_eq!(not_negative("0"), Ok(0.0));
        assert_eq!(share("1"), Ok(1.0));
        assert_eq!(above_one("1.5"), Ok(1.5));
        for wrong in [positive("0"), positive("inf"), not_negative("-1"), share("1.1"), share("NaN"), above_one("1")] {
            assert!(wrong.unwrap_err().starts_with("must be"));
        }
        assert!(positive("one").is_err());
    }
}
