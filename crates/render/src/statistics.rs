//! Statistics of a dataset: the paper's Table I and a histogram of flow magnitudes.

use serde::{Deserialize, Serialize};
use srflow_core::{FlowField, Mask};

use srflow_data::manifest::{Manifest, SceneSplit};

/// Bins of the histogram: below 1/16 px, then one for each power of two up to 128 px, and above.
pub const BINS: usize = 13;

/// Flow magnitudes on the head.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct FlowSummary {
    /// Pixels of the head mask.
    pub pixels: u64,
    /// Pixels of the head mask that are not visible in the next frame.
    pub occluded: u64,
    /// Sum of magnitudes, in pixels.
    pub sum: f64,
    /// Maximum magnitude, in pixels.
    pub max: f32,
    /// Number of pixels in each bin, see [`bin_edges`].
    pub histogram: [u64; BINS],
}

/// Edges of the histogram's bins in pixels: bin `i` ranges from edge `i` to edge `i + 1`, the last one is open.
pub fn bin_edges() -> [f32; BINS] {
    std::array::from_fn(|i| if i == 0 { 0.0 } else { f32::from_bits((127 - 5 + i as u32) << 23) })
}

impl FlowSummary {
    /// Statistics of one frame's flow where `mask` is true.
    pub fn of(flow: &FlowField, mask: &Mask, occlusion: &Mask) -> Self {
        let mut summary = Self::default();
        let mut greatest_square = 0.0_f32;
        for y in 0..flow.height().min(mask.height()).min(occlusion.height()) {
            let mut row_sum = 0.0_f64;
            for ((&[u, v], &inside), &hidden) in flow.row(y).iter().zip(mask.row(y)).zip(occlusion.row(y)) {
                if inside {
                    let square = u * u + v * v;
                    summary.histogram[bin_of_square(square)] += 1;
                    summary.occluded += u64::from(hidden);
                    greatest_square = greatest_square.max(square);
                    row_sum += f64::from(square.sqrt());
                }
            }
            summary.sum += row_sum;
        }
        summary.pixels = summary.histogram.iter().sum();
        summary.max = greatest_square.sqrt();
        summary
    }

    /// Adds the statistics of another frame.
    pub fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.occluded += other.occluded;
        self.sum += other.sum;
        self.max = self.max.max(other.max);
        for (count, more) in self.histogram.iter_mut().zip(other.histogram) {
            *count += more;
        }
    }

    /// Mean magnitude in pixels; 0 without pixels.
    pub fn mean(&self) -> f64 {
        if self.pixels == 0 { 0.0 } else { self.sum / self.pixels as f64 }
    }
}

/// The bin of a squared magnitude. Half its binary exponent is the exponent of the magnitude.
fn bin_of_square(square: f32) -> usize {
    let exponent = ((square.to_bits() >> 23) as i32 - 127) >> 1;
    (exponent + 5).clamp(0, BINS as i32 - 1) as usize
}

/// The contents of `statistics.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct Statistics {
    pub scenes: usize,
    /// Mean number of frame pairs per scene, "Avg. Frames" in the paper's Table I.
    pub average_frames: f64,
    /// Number of frame pairs, "Total Frames" in the paper's Table I.
    pub total_frames: u64,
    /// Frame width in pixels.
    pub width: usize,
    /// Frame height in pixels.
    pub height: usize,
    /// Scenes and pairs of train, val and test.
    pub splits: Vec<SplitStatistics>,
    /// Mean flow magnitude on the head, in pixels.
    pub mean_magnitude: f64,
    /// Share of the head's pixels that are not visible in the next frame.
    pub occluded_share: f64,
    /// Lower edges of the histogram's bins, in pixels.
    pub bin_edges: [f32; BINS],
    /// All flow magnitudes on the head.
    pub flow: FlowSummary,
}

#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SplitStatistics {
    pub split: SceneSplit,
    pub scenes: usize,
    pub pairs: u64,
}

impl Statistics {
    /// Statistics of a complete dataset, with the flow of all pairs summed up in `flow`.
    pub fn new(manifest: &Manifest, flow: FlowSummary) -> Self {
        let scenes = manifest.scenes.len();
        let splits = SceneSplit::ALL.map(|split| SplitStatistics {
            split,
            scenes: manifest.scenes_of(split).count(),
            pairs: manifest.scenes_of(split).map(|scene| u64::from(scene.pairs)).sum(),
        });
        let share = |part: u64, whole: u64| if whole == 0 { 0.0 } else { part as f64 / whole as f64 };
        Self {
            scenes,
            average_frames: share(manifest.pairs(), scenes as u64),
            total_frames: manifest.pairs(),
            width: manifest.arguments.width,
            height: manifest.arguments.height,
            splits: splits.to_vec(),
            mean_magnitude: flow.mean(),
            occluded_share: share(flow.occluded, flow.pixels),
            bin_edges: bin_edges(),
            flow,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bins_are_powers_of_two() {
        assert_eq!(bin_edges()[..6], [0.0, 0.0625, 0.125, 0.25, 0.5, 1.0]);
        assert_eq!(bin_edges()[12], 128.0);
        for (bin, edge) in bin_edges().into_iter().enumerate() {
            assert_eq!(bin_of_square(edge * edge), bin);
            assert_eq!(bin_of_square(edge * edge * 1.1), bin);
        }
        assert_eq!((bin_of_square(1e-30), bin_of_square(f32::MAX)), (0, 12));
    }

    #[test]
    fn only_the_head_counts_and_sums_add_up() {
        let flow =
            FlowField::from_fn(4, 2, |x, y| [[0.0, 0.0], [3.0, 4.0], [-0.3, 0.0], [0.0, 200.0]][(x + y) % 4]);
        let mask = Mask::from_fn(4, 2, |x, _| x > 0);
        let occlusion = Mask::from_fn(4, 2, |x, _| x < 2);
        let mut summary = FlowSummary::of(&flow, &mask, &occlusion);
        assert_eq!((summary.pixels, summary.occluded, summary.max), (6, 2, 200.0));
        assert!((summary.mean() - (5.0 + 0.3 + 200.0 + 0.3 + 200.0) / 6.0).abs() < 1e-4);
        assert_eq!(summary.histogram, [1, 0, 0, 2, 0, 0, 0, 1, 0, 0, 0, 0, 2]);
        summary.add(&summary.clone());
        assert_eq!((summary.pixels, summary.histogram[12]), (12, 4));
    }
}
