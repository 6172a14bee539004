use std::fmt;
use std::ops::Deref;
use std::str::FromStr;

/// A colour, sRGB; written `#rrggbb`, and read as [`parse_color`] does.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Color(pub [u8; 3]);

impl Deref for Color {
    type Target = [u8; 3];

    fn deref(&self) -> &[u8; 3] {
        &self.0
    }
}

impl fmt::Display for Color {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let [r, g, b] = self.0;
        write!(f, "#{r:02x}{g:02x}{b:02x}")
    }
}

impl FromStr for Color {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        parse_color(text).map(Self)
    }
}

crate::serialize_as_text!(Color);

/// Parses a colour: `white`, `black`, `#rrggbb`, or `R,G,B` of 0 to 255 each.
///
/// # Errors
/// When it has none of these forms; the message lists them.
pub fn parse_color(text: &str) -> Result<[u8; 3], String> {
    let hexadecimal = |digits: &str| {
        let six = digits.len() == 6 && digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        let value = six.then(|| u32::from_str_radix(digits, 16).ok())??;
        let [_, r, g, b] = value.to_be_bytes();
        Some([r, g, b])
    };
    let color = match (text, text.strip_prefix('#')) {
        ("white", _) => Some([255; 3]),
        ("black", _) => Some([0; 3]),
        (_, Some(digits)) => hexadecimal(digits),
        _ => {
            let channels: Option<Vec<u8>> =
                text.split(',').map(|channel| channel.trim().parse().ok()).collect();
            channels.and_then(|channels| channels.try_into().ok())
        }
    };
    color.ok_or_else(|| "expected white, black, #rrggbb, or R,G,B of 0 to 255 each".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_color_is_a_word_six_digits_or_three_numbers() {
        assert_eq!(parse_color("white"), Ok([255; 3]));
        assert_eq!(parse_color("#336699"), Ok([0x33, 0x66, 0x99]));
        assert_eq!(parse_color("255, 128,0"), Ok([255, 128, 0]));
        for wrong in ["", "grey", "#33669", "#3366999", "#+33669", "1,2", "1,2,300", "1,2,3,4"] {
            assert!(parse_color(wrong).is_err(), "{wrong}");
        }
    }
}
