//! The patterns of motion that training clips are made of: a clip that they do not explain is unlike all that the model has seen.

use srflow_core::dense::dot;
use srflow_core::random::Key;

/// So many patterns; fewer for few clips.
const MOST: usize = 16;
/// For each pattern there are so many clips at least.
const CLIPS_PER_PATTERN: usize = 4;
/// Rounds of the iteration that finds them.
const ROUNDS: usize = 100;
/// Of clips that had no part in the patterns, so many are explained.
const EXPLAINED: f64 = 0.99;

/// Orthonormal patterns of motion, whatever its size.
#[derive(Debug, Clone, PartialEq)]
pub struct Patterns(pub Vec<Vec<f64>>);

impl Patterns {
    /// The principal directions of clips of length 1, by orthogonal iteration.
    pub fn of(clips: &[Vec<f32>]) -> Self {
        let clips: Vec<Vec<f64>> = clips.iter().filter_map(|clip| unit(clip)).collect();
        let length = clips.first().map_or(0, Vec::len);
        let count = (clips.len() / CLIPS_PER_PATTERN).min(MOST).min(length);
        let mut stream = Key::new(0).stream("patterns");
        let mut found: Vec<Vec<f64>> =
            (0..count).map(|_| (0..length).map(|_| f64::from(stream.normal())).collect()).collect();
        for _ in 0..ROUNDS {
            for pattern in &mut found {
                let mut next = vec![0.0; length];
                for clip in &clips {
                    let share = dot(clip, pattern);
                    next.iter_mut().zip(clip).for_each(|(sum, value)| *sum += share * value);
                }
                *pattern = next;
            }
            orthonormalize(&mut found);
        }
        Self(found)
    }

    /// The part of a clip's motion that they leave unexplained, 0 to 1; 0 without motion.
    pub fn unexplained(&self, clip: &[f32]) -> f64 {
        let Some(clip) = unit(clip) else { return 0.0 };
        let explained: f64 = self.0.iter().map(|pattern| dot(&clip, pattern).powi(2)).sum();
        (1.0 - explained).max(0.0).sqrt()
    }
}

/// The unexplained part up to which a clip is like those of training: nearly all clips of one half of the subjects are within it by
/// patterns of the other half. `clips` come with their subjects' numbers. 1, which excludes none, with fewer than two subjects.
pub fn limit(clips: &[(usize, Vec<f32>)]) -> f64 {
    let half = |even: bool| -> Vec<Vec<f32>> {
        let of_half = clips.iter().filter(|(subject, _)| subject.is_multiple_of(2) == even);
        of_half.map(|(_, clip)| clip.clone()).collect()
    };
    let halves = [half(true), half(false)];
    if halves.iter().any(Vec::is_empty) {
        return 1.0;
    }
    let [first, second] = halves.each_ref().map(|clips| Patterns::of(clips));
    let of_first = halves[0].iter().map(|clip| second.unexplained(clip));
    let mut all: Vec<f64> = of_first.chain(halves[1].iter().map(|clip| first.unexplained(clip))).collect();
    all.sort_by(f64::total_cmp);
    all[((all.len() - 1) as f64 * EXPLAINED).ceil() as usize]
}

/// A clip of length 1; `None` without motion.
fn unit(clip: &[f32]) -> Option<Vec<f64>> {
    let clip: Vec<f64> = clip.iter().copied().map(f64::from).collect();
    let length = dot(&clip, &clip).sqrt();
    (length > 0.0).then(|| clip.iter().map(|value| value / length).collect())
}

/// By Gram and Schmidt, twice for the sake of rounding. What depends on those before becomes 0.
fn orthonormalize(vectors: &mut [Vec<f64>]) {
    for _ in 0..2 {
        for place in 0..vectors.len() {
            let (before, rest) = vectors.split_at_mut(place);
            let vector = &mut rest[0];
            let size = dot(vector, vector).sqrt();
            for other in before {
                let share = dot(vector, other);
                vector.iter_mut().zip(other).for_each(|(value, other)| *value -= share * *other);
            }
            let length = dot(vector, vector).sqrt();
            let scale = if length > 1e-9 * size { 1.0 / length } else { 0.0 };
            vector.iter_mut().for_each(|value| *value *= scale);
        }
    }
}
