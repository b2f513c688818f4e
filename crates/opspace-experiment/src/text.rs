//! Numbers as text.

/// Largest number that is only rounding, in an SI unit: no result has such digits.
pub(crate) const NOISE: f64 = 1e-9;

/// Returns a number in an SI unit, or zero in place of rounding.
pub(crate) fn without_noise(number: f64) -> f64 {
    if number.abs() < NOISE { 0.0 } else { number }
}

/// Formats a number with four significant digits: `0.01234`, `12.34`, `1.234e-7`.
#[must_use]
pub fn format_number(number: f64) -> String {
    format_digits(number, 4)
}

/// Formats a number with three significant digits and no trailing zeros: `8.35`, `40`, `-0.12`, `1.2e-9`.
pub fn format_short(number: f64) -> String {
    format_trimmed(number, 3)
}

/// Formats a number with up to `digits` significant digits and no trailing zeros.
pub fn format_trimmed(number: f64, digits: usize) -> String {
    let text = format_digits(number, digits);
    let (digits, exponent) = text.find('e').map_or((text.as_str(), ""), |at| text.split_at(at));
    let digits =
        if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.') } else { digits };
    format!("{digits}{exponent}")
}

fn format_digits(number: f64, digits: usize) -> String {
    if !number.is_finite() {
        return if number.is_nan() { "not a number".to_owned() } else { format!("{number}") };
    }
    if number == 0.0 {
        return "0".to_owned();
    }
    // The exponent is determined after rounding: 0.99999 becomes 1.000, not 0.9999 or 1.0000.
    let rounded = format!("{number:.*e}", digits - 1);
    let (_, exponent) = rounded.split_once('e').unwrap_or((&rounded, "0"));
    match exponent.parse::<i32>().unwrap_or(0) {
        exponent @ -4..=5 => {
            format!("{number:.*}", usize::try_from(digits as i32 - 1 - exponent).unwrap_or(0))
        }
        _ => rounded,
    }
}

/// Names of things in a sentence: `x, y and z`.
pub fn listed(names: &[String]) -> String {
    match names {
        [names @ .., last] if !names.is_empty() => format!("{} and {last}", names.join(", ")),
        _ => names.concat(),
    }
}

/// Text that begins with a capital letter.
pub fn capitalised(text: &str) -> String {
    let mut text = text.to_owned();
    if let Some(first) = text.get_mut(..1) {
        first.make_ascii_uppercase();
    }
    text
}
