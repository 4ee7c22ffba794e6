//! Formatting of fractions in percent.

/// Formats a fraction in percent with three significant digits.
pub fn percent(fraction: f64) -> String {
    let p = 100.0 * fraction;
    if p <= 0.0 {
        return "0 %".to_owned();
    }
    let decimals = (2 - p.log10().floor() as i32).clamp(0, 9) as usize;
    format!("{p:.decimals$} %")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn percents_have_three_digits() {
        for (fraction, text) in [
            (0.0, "0 %"),
            (0.5, "50.0 %"),
            (0.0123, "1.23 %"),
            (0.000_012_34, "0.00123 %"),
            (1.0, "100 %"),
        ] {
            assert_eq!(percent(fraction), text);
        }
    }
}
