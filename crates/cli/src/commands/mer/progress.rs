//! What `srflow mer run` shows while it works.

use std::collections::BTreeSet;

use indicatif::{ProgressBar, ProgressStyle};
use srflow_mer::{LosoEvent, Sample};

/// A bar over the clips of one method.
pub fn feature_progress(clips: usize, method: &str) -> anyhow::Result<ProgressBar> {
    let style = ProgressStyle::with_template("{msg}: features {bar:30} {pos}/{len}, ETA {eta}")?;
    Ok(ProgressBar::new(clips as u64).with_style(style).with_message(method.to_owned()))
}

/// One bar over the training of all sets and methods, in clips learned from, which time follows.
pub struct TrainingProgress {
    /// Its message is what is being trained.
    pub bar: ProgressBar,
    epochs: usize,
}

impl TrainingProgress {
    pub fn new(epochs: usize) -> anyhow::Result<Self> {
        let style =
            ProgressStyle::with_template("{msg}: training {bar:30} {percent}% in {elapsed}, ETA {eta}")?;
        Ok(Self { bar: ProgressBar::new(0).with_style(style).with_message("classifiers"), epochs })
    }

    /// Counts in a set, each of whose subjects is left out once.
    pub fn expect<'a>(&self, samples: impl Iterator<Item = &'a Sample>) {
        let (mut clips, mut subjects) = (0, BTreeSet::new());
        for sample in samples {
            clips += 1;
            subjects.insert((&sample.dataset, &sample.subject));
        }
        self.bar.inc_length((clips * subjects.len().saturating_sub(1) * self.epochs) as u64);
    }

    pub fn show(&self, event: LosoEvent) {
        match event {
            LosoEvent::Epoch { clips } => self.bar.inc(clips as u64),
            LosoEvent::Fold { clips, resumed: true } => {
                self.bar.inc((clips * self.epochs) as u64);
                self.bar.reset_eta(); // how fast folds are read tells nothing of how fast they are trained
            }
            LosoEvent::Fold { resumed: false, .. } => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use srflow_mer::Features;
    use srflow_read::micro_expression::EmotionClass;

    use super::*;

    #[test]
    fn the_bar_is_full_when_every_fold_is_done() {
        let sample = |subject: &str, clip: &str| Sample {
            dataset: "made-up".into(),
            subject: subject.into(),
            clip: clip.into(),
            class: EmotionClass::Negative,
            features: Features::from_values(vec![0.0; Features::LEN]).unwrap(),
        };
        let samples = [sample("1", "a"), sample("2", "a"), sample("2", "b"), sample("3", "a")];
        let progress = TrainingProgress::new(5).unwrap();
        progress.expect(samples.iter());
        for clips in [3, 2] {
            (0..5).for_each(|_| progress.show(LosoEvent::Epoch { clips }));
            progress.show(LosoEvent::Fold { clips, resumed: false });
        }
        assert_eq!(progress.bar.position(), 25);
        progress.show(LosoEvent::Fold { clips: 3, resumed: true });
        assert_eq!(progress.bar.length(), Some(progress.bar.position()));
    }
}
