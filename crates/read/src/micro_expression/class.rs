use std::fmt;

/// The three classes of the composite micro-expression benchmark (MEGC 2019), with its numbers.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EmotionClass {
    /// Anger, disgust, contempt, fear, sadness, repression.
    Negative = 0,
    Positive = 1,
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
