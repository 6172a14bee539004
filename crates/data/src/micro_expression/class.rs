use srflow_core::named;

/// The three classes of the composite micro-expression benchmark (MEGC 2019), with its numbering.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash)]
pub enum EmotionClass {
    /// Anger, disgust, contempt, fear, sadness, repression.
    Negative = 0,
    Positive = 1,
    Surprise = 2,
}

named!(EmotionClass, "a class of the benchmark", {
    Negative => "negative",
    Positive => "positive",
    Surprise => "surprise",
});
