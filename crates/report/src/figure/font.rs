//! Helvetica, one of the 14 fonts that every PDF viewer has: its characters and their widths.

/// Widths of Helvetica's characters in thousandths of the font size, by their codes in WinAnsiEncoding from 32 on; 0 where the
/// encoding has no character. From Adobe's metrics of the 14 core fonts (`Helvetica.afm`).
#[rustfmt::skip]
const WIDTHS: [u16; 224] = [
    278, 278, 355, 556, 556, 889, 667, 191, 333, 333, 389, 584, 278, 333, 278, 278,
    556, 556, 556, 556, 556, 556, 556, 556, 556, 556, 278, 278, 584, 584, 584, 556,
    1015, 667, 667, 722, 722, 667, 611, 778, 722, 278, 500, 667, 556, 833, 722, 778,
    667, 778, 722, 667, 611, 722, 667, 944, 667, 667, 611, 278, 278, 278, 469, 556,
    333, 556, 556, 500, 556, 556, 278, 556, 556, 222, 222, 500, 222, 833, 556, 556,
    556, 556, 333, 500, 278, 556, 500, 722, 500, 500, 500, 334, 260, 334, 584, 0,
    556, 0, 222, 556, 333, 1000, 556, 556, 333, 1000, 667, 333, 1000, 0, 611, 0,
    0, 222, 222, 333, 333, 350, 556, 1000, 333, 1000, 500, 333, 944, 0, 500, 667,
    278, 333, 556, 556, 556, 556, 260, 556, 333, 737, 370, 556, 584, 0, 737, 333,
    400, 584, 333, 333, 333, 556, 537, 278, 333, 333, 365, 556, 834, 834, 834, 611,
    667, 667, 667, 667, 667, 667, 1000, 722, 667, 667, 667, 667, 278, 278, 278, 278,
    722, 722, 778, 778, 778, 778, 778, 584, 778, 722, 722, 722, 722, 667, 667, 611,
    556, 556, 556, 556, 556, 556, 889, 500, 556, 556, 556, 556, 278, 278, 278, 278,
    556, 556, 556, 556, 556, 556, 556, 584, 611, 556, 556, 556, 556, 500, 556, 500,
];

/// The characters of WinAnsiEncoding at 128 to 159, where it differs from Latin-1; a space where it has none.
const AT_128: &str = "€ ‚ƒ„…†‡ˆ‰Š‹Œ Ž  ‘’“”•–—˜™š›œ žŸ";

/// Height of capital letters above the baseline, and depth of letters below it, in units of the font size.
pub const ASCENT: f64 = 0.718;
pub const DESCENT: f64 = 0.207;

/// The code of a character in WinAnsiEncoding; `None` if the font does not have it.
pub fn code(c: char) -> Option<u8> {
    let code = match u32::from(c) {
        code @ (0x20..=0x7e | 0xa0..=0xff) => code as u8,
        _ => 128 + u8::try_from(AT_128.chars().position(|known| known == c)?).ok()?,
    };
    (WIDTHS[usize::from(code) - 32] > 0).then_some(code)
}

/// Width of a text in units of the font size. Characters that the font lacks count as squares.
pub fn width(text: &str) -> f64 {
    let width = |c| code(c).map_or(1000, |code| WIDTHS[usize::from(code) - 32]);
    text.chars().map(|c| f64::from(width(c)) / 1000.0).sum()
}

/// The text, shortened with an ellipsis to a width in units of the font size.
pub fn shortened(text: &str, most: f64) -> String {
    const ROUNDING: f64 = 1e-6;
    if width(text) <= most + ROUNDING {
        return text.to_owned();
    }
    let mut kept = String::new();
    for c in text.chars() {
        kept.push(c);
        if width(&kept) + width("…") > most {
            kept.pop();
            break;
        }
    }
    kept.truncate(kept.trim_end().len());
    kept + "…"
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn codes_are_those_of_win_ansi() {
        for (c, expected) in
            [('A', 65), ('~', 126), ('€', 128), ('…', 133), ('–', 150), ('™', 153), ('Ÿ', 159), ('ÿ', 255)]
        {
            assert_eq!(code(c), Some(expected), "{c}");
        }
        assert_eq!(AT_128.chars().count(), 32);
        for missing in ['\n', '\u{7f}', '\u{81}', '\u{ad}', '→', 'Δ', '顔', '😀'] {
            assert_eq!(code(missing), None, "{missing:?}");
        }
    }

    #[test]
    fn text_has_the_width_of_its_characters() {
        assert!((width("EPE 0.5") - 3.669).abs() < 1e-9, "{}", width("EPE 0.5"));
        assert_eq!(width(""), 0.0);
        assert_eq!(width("顔"), 1.0);
    }

    #[test]
    fn long_text_ends_in_an_ellipsis_within_its_width() {
        let long = "a very long name of a method";
        for most in [0.0, 1.2, 5.0, 9.0] {
            let short = shortened(long, most);
            assert!(short.ends_with('…') && width(&short) <= most.max(1.0), "{short}");
        }
        assert_eq!(shortened(long, 20.0), long);
    }
}
