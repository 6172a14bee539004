//! Classes of unlike frequency: how training makes up for it.

use srflow_core::random::Stream;
use srflow_core::{named, serialize_as_text};

/// How training treats classes that have more clips than others.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Balance {
    /// Every clip counts alike.
    #[default]
    None,
    /// In the cross-entropy, a clip counts by the inverse frequency of its class among the training clips, so that all classes count alike.
    Weights,
    /// In each epoch of a network, as many clips as there are are drawn with replacement, each class as often as the others.
    Sampling,
}

named!(Balance, "a way to balance classes", { None => "none", Weights => "weights", Sampling => "sampling" });
serialize_as_text!(Balance);

impl Balance {
    /// How much a clip of each class counts in the loss. Over the clips with these labels, the mean is 1.
    pub(crate) fn class_weights(self, labels: &[usize], classes: usize) -> Vec<f64> {
        if self != Self::Weights {
            return vec![1.0; classes];
        }
        let clips = by_class(labels, classes);
        let present = clips.iter().filter(|clips| !clips.is_empty()).count();
        let weight = |clips: &Vec<usize>| labels.len() as f64 / (present * clips.len().max(1)) as f64;
        clips.iter().map(weight).collect()
    }

    /// Puts into `order`, a permutation of the clips with these labels, the clips of an epoch.
    pub(crate) fn arrange(self, order: &mut [usize], labels: &[usize], classes: usize, stream: &mut Stream) {
        if self != Self::Sampling {
            return stream.shuffle(order);
        }
        let mut clips = by_class(labels, classes);
        clips.retain(|clips| !clips.is_empty());
        let one_of = |count: usize, stream: &mut Stream| stream.below(count as u32) as usize;
        for place in order {
            let of_class = &clips[one_of(clips.len(), stream)];
            *place = of_class[one_of(of_class.len(), stream)];
        }
    }
}

/// The numbers of the clips of each class.
fn by_class(labels: &[usize], classes: usize) -> Vec<Vec<usize>> {
    let mut clips = vec![Vec::new(); classes];
    labels.iter().enumerate().for_each(|(clip, class)| clips[*class].push(clip));
    clips
}
