use std::fmt;
use std::str::FromStr;

/// The three classes of the composite micro-expression benchmark (MEGC 2019), with its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EmotionClass {
    /// Anger, disgust, contempt, fear, sadness, repression.
    Negative = 0,
    /// Happiness.
    Positive = 1,
    /// Surprise.
    Surprise = 2,
}

impl EmotionClass {
    /// Every class, in the order of their numbers.
    pub const ALL: [EmotionClass; 3] = [Self::Negative, Self::Positive, Self::Surprise];

    /// `negative`, `positive` or `surprise`, as tables and files have it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Negative => "negative",
            Self::Positive => "positive",
            Self::Surprise => "surprise",
        }
    }
}

impl fmt::Display for EmotionClass {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(self.name())
    }
}

impl FromStr for EmotionClass {
    type Err = String;

    /// Reads the class's name, in letters of either case, or its number.
    fn from_str(text: &str) -> Result<Self, String> {
        let text = text.trim();
        let is = |class: &Self| class.name().eq_ignore_ascii_case(text) || text == (*class as u8).to_string();
        Self::ALL.into_iter().find(is).ok_or_else(|| {
            format!(
                "`{text}` is not a class; expected negative, positive or surprise, or its number 0, 1 or 2"
            )
        })
    }
}
