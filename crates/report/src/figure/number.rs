/// Places and sizes on the page, to a thousandth of a point: the same digits on every machine.
pub fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

/// A number as text, to a thousandth and without unnecessary digits.
pub fn number(value: f64) -> String {
    let rounded = rounded(value);
    (if rounded == 0.0 { 0.0 } else { rounded }).to_string()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_are_short() {
        let shown = [0.0, -0.0001, 1.0, 0.12345, 504.5669, -2.5].map(number);
        assert_eq!(shown, ["0", "0", "1", "0.123", "504.567", "-2.5"]);
    }
}
